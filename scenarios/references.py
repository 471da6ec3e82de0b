"""The references of a scenario as arrays and as the file that the runtime reads."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from scenarios.schema import References, Scenario
from sim_bridge.conditions import FlightCondition
from task.config import read_bytes
from task.errors import UserError
from task.limits import DT
from task.reference import base_reference, n_samples, random_reference
from task.state import REFERENCE, STATE

HEADER = ",".join(("t", *(signal.name for signal in REFERENCE)))
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
        return [NamedReference(path.stem, read_csv(path, n_samples(duration)))]
    trim = trim_pitch(scenario.flight.condition)
    if spec.source == "base":
        return [NamedReference("base", base_reference(duration, trim))]
    return [
        NamedReference(
            f"{spec.family}-{seed}", random_reference(np.random.default_rng(seed), duration, trim, spec.family)
        )
        for seed in spec.seeds
    ]


def with_count(spec: References, count: int) -> References:
    """Return a spec of ``count`` random references: the seeds given, then those that follow the largest."""
    seeds = list(spec.seeds[:count])
    while len(seeds) < count:
        seeds.append(max(seeds, default=0) + 1)
    return References(source="random", family=spec.family, seeds=tuple(seeds))


def csv_bytes(rows: np.ndarray) -> bytes:
    """Return a reference (T, 3) [rad] as CSV, exact to the last bit."""
    lines = [HEADER]
    for k, row in enumerate(rows.tolist()):
        lines.append(",".join(repr(v) for v in (round(k * DT, 9), *row)))
    return ("\n".join(lines) + "\n").encode()


def read_csv(path: Path, samples: int) -> np.ndarray:
    """Read a reference file onto the task's samples, shape (samples, 3) [rad]; its last row is held.

    Raises UserError for a file that is missing or is no table of t, theta, phi, beta.
    """
    lines = [line for line in read_bytes(path, "reference").decode(errors="replace").splitlines() if line.strip()]
    if lines and lines[0].replace(" ", "") == HEADER:
        lines = lines[1:]
    try:
        table = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    except ValueError:
        table = np.zeros((0, 0))
    if table.ndim != 2 or table.shape[1] != 1 + len(REFERENCE) or not np.isfinite(table).all():
        raise UserError(f"{path}: not a reference; expected rows of {HEADER} [s, rad], all of them finite numbers")
    if not (np.diff(table[:, 0]) > 0.0).all() or table[0, 0] > 0.0:
        raise UserError(f"{path}: time must start at 0 s and rise from row to row")
    grid = np.arange(samples) * DT
    return np.column_stack([np.interp(grid, table[:, 0], column) for column in table[:, 1:].T])
