"""A flight made by hand, for what needs its shape and not its dynamics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from scenarios.references import NamedReference
from scenarios.run import Job, Result
from scenarios.schema import CHOICES
from scenarios.score import score_flight
from scenarios.trace import AdaptationTrace, FlightTrace, Play, Switch
from sim_bridge.flight import Flight
from task.reference import base_reference
from task.state import N_ACTION, N_STATE, REFERENCE, STATE

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
    job = Job(Flight(duration=SECONDS), CHOICES[mode], NamedReference(reference, rows), Path("cast"), Path())
    return Result(job, flight, adaptation, score_flight(flight, adaptation), seconds=1.0, reused=False)


@pytest.fixture
def make_result() -> Callable[..., Result]:
    """Return :func:`result`."""
    return result


@pytest.fixture(scope="session")
def cast(mirrored_folder: Path) -> Path:
    """Return the cast of the campaign's tests: the folder of a linear law that tracks well, and its mirrors."""
    return mirrored_folder
