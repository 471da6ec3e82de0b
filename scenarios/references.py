"""The references of a scenario as arrays and as the file that the runtime reads."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from runtime.reference import COLUMNS, load_reference
from scenarios.schema import References, Scenario
from sim_bridge.conditions import FlightCondition
from task.limits import DT
from task.reference import base_reference, n_samples, random_reference
from task.state import STATE

HEADER = ",".join(COLUMNS)
"""Columns of a reference file: time [s], then angles [rad]."""


class NamedReference(NamedTuple):
    """One reference and what it is called in folders and tables."""

    name: str
    rows: np.ndarray
    """(T, 3) theta, phi, beta [rad], one row a sample."""


def trim_pitch(condition: FlightCondition) -> float:
    """Return the pitch of the trimmed aircraft [rad]. Raises UserError when it cannot be trimmed there."""
    from sim_bridge.plant import Plant  # here: a report alone needs no simulator

    plant = Plant()
    plant.reset(condition)
    return float(plant.trim.x[STATE.theta])


def build(scenario: Scenario, folder: Path) -> list[NamedReference]:
    """Return the references of a scenario; ``folder`` is where a relative file lies. Raises UserError."""
    spec, duration = scenario.references, scenario.flight.duration
    if spec.source == "file":
        path = folder / str(spec.file)
        return [NamedReference(path.stem, read(path, n_samples(duration)))]
    trim = trim_pitch(scenario.flight.condition)
    if spec.source == "base":
        return [NamedReference("base", base_reference(duration, trim))]
    return [
        NamedReference(
            f"{spec.kind()}-{seed}", random_reference(np.random.default_rng(seed), duration, trim, spec.kind())
        )
        for seed in spec.drawn()
    ]


def with_count(spec: References, count: int) -> References:
    """Return a spec of ``count`` random references: the seeds given, then those that follow the largest."""
    seeds = list(spec.drawn()[:count])
    while len(seeds) < count:
        seeds.append(max(seeds, default=0) + 1)
    return References(source="random", family=spec.kind(), seeds=tuple(seeds))


def csv_bytes(rows: np.ndarray) -> bytes:
    """Return a reference (T, 3) [rad] as CSV, exact to the last bit."""
    lines = [HEADER]
    for k, row in enumerate(rows.tolist()):
        lines.append(",".join(repr(v) for v in (round(k * DT, 9), *row)))
    return ("\n".join(lines) + "\n").encode()


def read(path: Path, samples: int) -> np.ndarray:
    """Read a reference file as the runtime does, onto the task's samples, shape (samples, 3) [rad]; its last is held.

    Raises UserError.
    """
    reference = load_reference(path)
    return np.array([reference.at(k * DT) for k in range(samples)])
