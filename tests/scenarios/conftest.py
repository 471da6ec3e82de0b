"""A flight made by hand, for what needs its shape and not its dynamics; and a small cast that flies well."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from export.folder import write_population
from export.mirrors import with_mirrors
from export.network import Layer, Network, flatten
from export.population import Description, Member, Population
from export.prior import Prior
from export.rates import RateSettings, rate_model
from scenarios.references import NamedReference
from scenarios.run import Job, Result
from scenarios.schema import MODES
from scenarios.score import score_flight
from scenarios.trace import AdaptationTrace, FlightTrace, Play, Switch
from sim_bridge.conditions import NOMINAL
from sim_bridge.flight import Flight
from task.reference import base_reference
from task.state import ACTION, N_ACTION, N_OBSERVATION, N_STATE, OBSERVATION, REFERENCE, STATE

SECONDS = 10.0


def result(mode: str = "understudy-soft", reference: str = "base", lost_at: float | None = None) -> Result:
    """Return a flight that follows its reference 1 deg low, with a fault at 4 s and a switch at 6 s."""
    rows = base_reference(SECONDS, 0.05)
    kept = len(rows) if lost_at is None else round(lost_at * 100)
    time = np.arange(kept) * 0.01
    x = np.zeros((kept, N_STATE))
    x[:, STATE.V], x[:, STATE.h] = 90.0, 2000.0
    x[:, STATE.phi] = rows[:kept, REFERENCE.phi]
    x[:, STATE.theta] = rows[:kept, REFERENCE.theta] - np.deg2rad(1.0)
    command = 0.05 * np.sin(time)[:, None] * np.ones(N_ACTION)
    flight = FlightTrace(time, x, rows[:kept], command, 0.9 * command, time >= 4.0, len(rows))
    rng = np.random.default_rng(3)
    adaptation = AdaptationTrace(
        time=time,
        active=(time >= 6.0).astype(int),
        innovation=rng.normal(0.0, 1e-5, (kept, 6)),
        members=["calm", "keen"],
        innovation_names=["p", "q", "r", "V", "alpha", "beta"],
        plays=[Play(t, np.array([-3.0, -2.0, -3.1])) for t in (2.0, 4.0, 6.0, 8.0)],
        switches=[Switch(6.0, 1)],
    )
    job = Job(Flight(duration=SECONDS), MODES[mode], NamedReference(reference, rows), Path("cast"), Path())
    return Result(job, flight, adaptation, score_flight(flight, adaptation), seconds=1.0, reused=False)


@pytest.fixture
def make_result() -> Callable[..., Result]:
    """Return :func:`result`."""
    return result


@pytest.fixture(scope="session")
def cast(tmp_path_factory: pytest.TempPathFactory, short_prior: Prior) -> Path:
    """Return the folder of a linear law that tracks well, and its mirrors."""
    network = Network(layers=(Layer(units=N_ACTION, activation="linear"),), action_scale=(1.0, 1.0, 1.0))
    gains = np.zeros((1, N_ACTION, N_OBSERVATION))
    gains[0, ACTION.de, [OBSERVATION.theta_e, OBSERVATION.q]] = -0.8, 0.4
    gains[0, ACTION.da, [OBSERVATION.phi_e, OBSERVATION.p]] = -0.6, 0.2
    gains[0, ACTION.dr, OBSERVATION.beta_e] = 0.3
    bias = np.array([[-0.02477, 0.0, 0.0]])
    member = (Member(name="good", scores={}),)
    description = Description(network=network, members=member, champion="good", training={})
    parameters = flatten(network, {"layers.0.weight": gains, "layers.0.bias": bias})
    folder = tmp_path_factory.mktemp("casts") / "mirrored"
    rates = rate_model(RateSettings(conditions=(NOMINAL,), duration=30.0))
    write_population(with_mirrors(Population(description, parameters), "linear cast"), short_prior, folder, rates=rates)
    return folder
