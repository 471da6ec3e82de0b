"""The suites as data: TOML files of faults.

Times count from the moment of the fault; any number may be a range, drawn anew for each flight.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from sim_bridge.faults import AnyFault
from task.config import Settings, convert, load_toml
from task.errors import UserError

FOLDER = Path(__file__).parent
SUITES = ("easy", "hard")
"""The suites of this package."""

Half = Literal["tuning", "reported"]
HALVES: tuple[Half, ...] = ("tuning", "reported")
"""Two disjoint halves: what is found on one is reported on the other."""

Trim = Literal["nominal", "R1", "R2", "between"]
SensorLevel = Literal["ideal", "noise", "twice the noise"]
AirLevel = Literal["still", "light", "moderate", "gust front"]

STRATA = 8
"""A range is cut in this many pieces; the halves of the campaign draw from every other one."""


class FaultCase(Settings, frozen=True):
    """What breaks in a flight, and what of its conditions the case itself says."""

    name: str
    """How tables call it; unique within all suites."""
    group: str
    """Cases that are summed up together: reversal, latency, published, ..."""
    faults: tuple[dict[str, Any], ...] = ()
    """As in a scenario (``sim_bridge.faults``), but ``start`` and ``end`` [s] count from the moment of the fault, and
    any number that is a value of its own, not one of a list, may be a pair [low, high]."""
    trim: Trim | None = None
    """The trimmed flight, when the case is about it."""
    sensors: SensorLevel | None = None
    """The sensors, when the case is about them."""
    air: AirLevel | None = None
    """The air, when the case is about it."""


class Suite(Settings, frozen=True):
    """One file of cases."""

    title: str
    """Name of the suite."""
    fault: Annotated[tuple[FaultCase, ...], Meta(min_length=1)]
    """Its cases."""


def half_uniform(rng: np.random.Generator, half: Half, low: float, high: float) -> float:
    """Return a number of [low, high), uniform over the strata of a half: the halves never draw the same number."""
    piece = 2 * int(rng.integers(STRATA // 2)) + HALVES.index(half)
    return low + (high - low) * (piece + float(rng.random())) / STRATA


def draw_faults(case: FaultCase, half: Half, rng: np.random.Generator, moment: float) -> tuple[AnyFault, ...]:
    """Return the faults of one flight: ranges drawn, times moved to ``moment`` [s]. Raises UserError."""
    drawn = []
    for part in case.faults:
        fault = {key: _drawn(value, half, rng) for key, value in part.items()}
        fault |= {
            key: moment + time
            for key, time in ({"start": 0.0} | fault).items()
            if key in ("start", "end") and type(time) in (int, float)
        }
        drawn.append(fault)
    return convert(drawn, tuple[AnyFault, ...], f"fault {case.name!r}")


def _drawn(value: Any, half: Half, rng: np.random.Generator) -> Any:
    if isinstance(value, list) and len(value) == 2 and all(isinstance(v, (int, float)) for v in value):
        return half_uniform(rng, half, *value)
    return value


def places(suite: str) -> dict[str, int]:
    """Return the place of each fault in the file of a suite of this package; nothing of another one."""
    return {case.name: i for i, case in enumerate(load_suite(suite).fault)} if suite in SUITES else {}


def load_suite(name: str) -> Suite:
    """Read a suite of this package, or a TOML file of the same shape; check every fault in it. Raises UserError."""
    if name not in SUITES and not name.endswith(".toml"):
        raise UserError(f"--suite {name}: no such suite; choose of {', '.join(SUITES)}, or give a .toml file")
    path = FOLDER / f"{name}.toml" if name in SUITES else Path(name)
    suite = load_toml(path, Suite, "suite")
    names = [case.name for case in suite.fault]
    if twice := {n for n in names if names.count(n) > 1}:
        raise UserError(f"{path}: fault {min(twice)!r} is there twice; give each its own name")
    for case in suite.fault:
        try:
            draw_faults(case, "tuning", np.random.default_rng(0), 10.0)
        except UserError as error:
            raise UserError(f"{path}: {error}") from None
    return suite
