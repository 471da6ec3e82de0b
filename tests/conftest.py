"""Random populations for all tests, written through the real export."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as in the Makefile: on more threads sums end in other last bits

import numpy as np
import pytest

from export.network import Layer, Network, flatten, layout
from export.population import Description, Member, Population

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
