"""Which flights a campaign flies: every fault on as many references, each in a condition of a balanced, seeded design.

The conditions are not the full product. For each fault every factor runs through random permutations of its levels, one
after the other, so that any number of references meets each level nearly as often as its weight says. Flight i of a
fault is the same however many are flown.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable
from typing import Literal

import numpy as np

from scenarios.campaign.suites import (
    HALVES,
    AirLevel,
    FaultCase,
    Half,
    SensorLevel,
    Suite,
    Trim,
    draw_faults,
    half_uniform,
)
from sim_bridge.air import Air
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.faults import AnyFault, Gust
from sim_bridge.flight import Flight
from sim_bridge.presets import R3_SENSORS
from sim_bridge.sensors import SensorSettings
from task.config import Settings
from task.limits import DT
from task.reference import FamilyName, n_samples, random_reference
from task.state import REFERENCE

DURATION = 40.0
"""Of a flight [s]."""
EARLIEST, LATEST = 8.0, 12.0
"""Between these a fault comes [s]."""
LEVEL_FOR, OPENING = 1.0, 3.0
"""A level flight stays level for so long after the fault, and takes so long to come back to its reference [s]."""

Moment = Literal["level", "manoeuvre"]

FACTORS: dict[str, tuple[str, ...]] = {
    "moment": ("level", "manoeuvre"),
    "references": ("evaluation", "aggressive"),
    "trim": ("nominal", "nominal", "R1", "R2", "between", "between"),
    "sensors": ("ideal", "ideal", "noise", "noise", "twice the noise"),
    "air": ("still", "still", "still", "still", "light", "light", "light", "moderate", "gust front", "gust front"),
    "preview": ("yes", "no"),
}
"""Factor: its levels, as often as they weigh."""


class Cell(Settings, frozen=True):
    """One flight of the design; every way of adapting flies the same one."""

    suite: str
    """Title of the suite."""
    fault: str
    """Name of the fault."""
    group: str
    """Its group."""
    index: int
    """Number of the flight among those of this fault."""
    half: Half
    """Half of the campaign."""
    moment: Moment
    """What the aircraft does when the fault comes."""
    references: FamilyName
    """Family of the reference."""
    trim: Trim
    """The trimmed flight."""
    sensors: SensorLevel
    """How good the sensors are."""
    air: AirLevel
    """How calm the air is."""
    preview: bool
    """Whether the imagination knows the reference beforehand."""
    fault_at: float
    """The moment of the fault [s]; scores begin here, also when there is none."""
    seed: tuple[int, int, int]
    """Of the reference."""
    flight: Flight
    """The aircraft's side."""

    @property
    def name(self) -> str:
        """Return a name that is unique in a half."""
        return f"{self.fault}/{self.index:03d}"


def _stream(half: Half, fault: str, *what: int | str) -> np.random.Generator:
    """Return the random stream of a thing; streams of different things and halves are independent."""
    keys = [HALVES.index(half), zlib.crc32(fault.encode())]
    return np.random.default_rng([*keys, *(w if isinstance(w, int) else zlib.crc32(w.encode()) for w in what)])


def balanced(levels: tuple[str, ...], count: int, rng: np.random.Generator) -> list[str]:
    """Return ``count`` levels: random permutations of all of them, one after the other."""
    out: list[str] = []
    while len(out) < count:
        out += [levels[i] for i in rng.permutation(len(levels))]
    return out[:count]


def cells(suite: Suite, half: Half, count: int) -> list[Cell]:
    """Return the flights of a suite, ``count`` of every fault."""
    found: list[Cell] = []
    for case in suite.fault:
        table = {name: balanced(levels, count, _stream(half, case.name, name)) for name, levels in FACTORS.items()}
        for i in range(count):
            level = {name: column[i] for name, column in table.items()}
            found.append(_cell(suite.title, case, half, i, level))
    return found


def _cell(suite: str, case: FaultCase, half: Half, index: int, level: dict[str, str]) -> Cell:
    rng = _stream(half, case.name, "flight", index)
    seed = tuple(int(s) for s in rng.integers(2**31, size=3))
    for factor in ("trim", "sensors", "air"):
        level[factor] = getattr(case, factor) or level[factor]
    family: FamilyName = "aggressive" if level["references"] == "aggressive" else "evaluation"
    moment = float(rng.uniform(EARLIEST, LATEST))
    if level["moment"] == "manoeuvre":
        moment = busiest(random_reference(np.random.default_rng(seed), DURATION, 0.0, family))
    moment = round(moment / DT) * DT
    faults = draw_faults(case, half, rng, moment)
    flight = Flight(
        duration=DURATION,
        condition=_condition(level["trim"], half, rng),
        air=Air(turbulence=level["air"] if level["air"] in ("light", "moderate") else "none"),  # type: ignore[arg-type]
        sensors=sensor_settings(level["sensors"]),
        faults=(*faults, *(_gust_front(half, rng, moment) if level["air"] == "gust front" else ())),
        seed=int(rng.integers(2**31)),
    )
    return Cell(
        suite=suite, fault=case.name, group=case.group, index=index, half=half,
        moment="level" if level["moment"] == "level" else "manoeuvre", references=family,
        trim=level["trim"], sensors=level["sensors"], air=level["air"],  # type: ignore[arg-type]
        preview=level["preview"] == "yes", fault_at=moment, seed=seed, flight=flight,  # type: ignore[arg-type]
    )  # fmt: skip


def busiest(rows: np.ndarray) -> float:
    """Return when a reference (T, 3) [rad] moves fastest within the time in which faults come [s]."""
    rate = np.abs(np.gradient(rows[:, : REFERENCE.phi + 1], DT, axis=0)).sum(axis=1)
    first, last = round(EARLIEST / DT), round(LATEST / DT)
    return (first + int(np.argmax(rate[first : last + 1]))) * DT


def reference_rows(cell: Cell, trim_pitch: float) -> np.ndarray:
    """Return the reference of a flight (T, 3) [rad]; in a level flight it begins after the fault.

    trim_pitch [rad]: of the aircraft at the start.
    """
    rows = random_reference(np.random.default_rng(cell.seed), DURATION, 0.0, cell.references)
    if cell.moment == "level":
        t = np.arange(len(rows)) * DT - cell.fault_at - LEVEL_FOR
        rows *= (0.5 - 0.5 * np.cos(np.pi * np.clip(t / OPENING, 0.0, 1.0)))[:, None]
    rows[:, REFERENCE.theta] += trim_pitch
    return rows[: n_samples(cell.flight.duration)]


def _condition(trim: str, half: Half, rng: np.random.Generator) -> FlightCondition:
    """Return a trimmed flight; ``between`` lies on the lines from nominal to R1 and R2."""
    if trim == "between":
        if rng.random() < 0.5:
            return FlightCondition(speed=half_uniform(rng, half, NOMINAL.speed, R1.speed))
        return FlightCondition(altitude=half_uniform(rng, half, NOMINAL.altitude, R2.altitude))
    return {"nominal": NOMINAL, "R1": R1, "R2": R2}[trim]


def sensor_settings(level: str) -> SensorSettings:
    """Return ideal sensors, the thesis's noise and biases of R3, or twice both."""
    scale = {"ideal": 0.0, "noise": 1.0, "twice the noise": 2.0}[level]
    if scale == 0.0:
        return SensorSettings()
    return SensorSettings(
        noise={name: scale * sd for name, sd in R3_SENSORS.noise.items()},
        bias={name: scale * bias for name, bias in R3_SENSORS.bias.items()},
    )


def _gust_front(half: Half, rng: np.random.Generator, moment: float) -> Iterable[AnyFault]:
    """Return air that moves at 3 to 6 m/s for some seconds, soon after the fault."""
    size = half_uniform(rng, half, 3.0, 6.0)
    heading, climb = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.5, 0.5)
    start = moment + float(rng.uniform(0.5, 4.0))
    across = size * math.cos(climb)
    return (
        Gust(
            start=start, end=start + float(rng.uniform(3.0, 8.0)), ramp=1.0, shape="cosine",
            north=across * math.cos(heading), east=across * math.sin(heading), down=size * math.sin(climb),
        ),
    )  # fmt: skip
