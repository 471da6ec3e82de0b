"""Populations for all tests, random ones and one that flies well, written through the real export."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as in the Makefile: on more threads sums end in other last bits

import numpy as np
import pytest

from export.mirrors import with_mirrors
from export.network import Layer, Network, flatten, layout
from export.population import Description, Member, Population
from task.state import ACTION, N_ACTION, N_OBSERVATION, OBSERVATION

if TYPE_CHECKING:
    from export.prior import Prior

MakeActors = Callable[..., Population]


def random_actors(network: Network, members: int = 4, seed: int = 0, gain: float = 0.5) -> Population:
    """Return actors with random parameters; the larger ``gain``, the steeper they answer."""
    rng = np.random.default_rng(seed)
    tensors = {}
    for tensor in layout(network):
        shape = (members, *tensor.shape)
        if tensor.name.endswith("gain"):
            tensors[tensor.name] = rng.uniform(0.5, 1.5, shape)
        else:
            tensors[tensor.name] = gain * rng.normal(size=shape) / np.sqrt(tensor.shape[-1])
    names = tuple(Member(name=f"actor-{i}", scores={"return": -float(i)}) for i in range(members))
    description = Description(network=network, members=names, champion="actor-1", training={"seed": seed})
    return Population(description, flatten(network, tensors))


@pytest.fixture(scope="session", autouse=True)
def _ctrl_c_is_heard() -> None:
    """Undo what a shell does to jobs in its background: they ignore Ctrl-C, and so would all that tests start."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def make_actors() -> MakeActors:
    """Return :func:`random_actors`."""
    return random_actors


@pytest.fixture(scope="session")
def short_prior() -> Prior:
    """Return a model prior from one short flight of the plant."""
    from export.prior import PriorSettings, model_prior  # here, so that most tests load no simulator

    return model_prior(PriorSettings(flights=1, duration=20.0))


@pytest.fixture(scope="session")
def population_folder(tmp_path_factory: pytest.TempPathFactory, short_prior: Prior) -> Path:
    """Return an exported population of four random actors, 16 wide; it does not fly well, it flies."""
    from export.folder import write_population

    hidden = tuple(Layer(units=16, layer_norm="standard") for _ in range(3))
    network = Network(layers=(Layer(units=16), *hidden, Layer(units=3)))
    folder = tmp_path_factory.mktemp("populations") / "random"
    write_population(random_actors(network), short_prior, folder)
    return folder


@pytest.fixture(scope="session")
def mirrored_folder(tmp_path_factory: pytest.TempPathFactory, short_prior: Prior) -> Path:
    """Return a linear law that tracks well, and its mirrors; the trim is its bias, the network's offset is zero."""
    from export.folder import write_population
    from export.rates import RateSettings, rate_model
    from sim_bridge.conditions import NOMINAL

    network = Network(layers=(Layer(units=N_ACTION, activation="linear"),), action_scale=(1.0, 1.0, 1.0))
    gains = np.zeros((1, N_ACTION, N_OBSERVATION))
    gains[0, ACTION.de, [OBSERVATION.theta_e, OBSERVATION.q]] = -0.8, 0.4
    gains[0, ACTION.da, [OBSERVATION.phi_e, OBSERVATION.p]] = -0.6, 0.2
    gains[0, ACTION.dr, OBSERVATION.beta_e] = 0.3
    bias = np.array([[-0.02477, 0.0, 0.0]])
    description = Description(network=network, members=(Member(name="good", scores={}),), champion="good", training={})
    parameters = flatten(network, {"layers.0.weight": gains, "layers.0.bias": bias})
    folder = tmp_path_factory.mktemp("casts") / "mirrored"
    rates = rate_model(RateSettings(conditions=(NOMINAL,), duration=30.0))
    write_population(with_mirrors(Population(description, parameters), "linear cast"), short_prior, folder, rates=rates)
    return folder
