"""What the link and the sensors may do in flight: noise, lost states, garbage, no usable state at all.

``python -m bench.robustness`` flies the shipped cast with ``ensemble`` and ``structured``, and the protected INDI and a
PID alone, through the runtime's own session; it writes ``results/robustness.json``. Nothing is wrong with the aircraft
but what a case says, so that a law that looks at nothing but its own sensors is hard to beat.

Predicted: nobody is lost that a PID keeps, and what was known of the commands stays known while states are lost.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from runtime.laws.catalogue import LawName, load_solo
from runtime.link import LOST, OVER, Sample
from runtime.population import Population, load_population
from runtime.presets import resolve
from runtime.reference import RecordedReference
from runtime.session import Session
from sim_bridge.faults import AnyFault, Effectiveness, Latency, SensorNoise, SensorStuck
from sim_bridge.flight import Flight
from sim_bridge.plant import Plant
from sim_bridge.presets import R3_SENSORS
from sim_bridge.world import World
from task.limits import DT
from task.metrics import nmae
from task.observation import tracking_error
from task.reference import random_reference
from task.results import Claim, Result, Table, write
from task.reward import terminated
from task.state import N_STATE, STATE
from understudy import run

CAST = Path("populations/citation")
AT, DURATION = 10.0, 25.0
"""When something happens, and the length of a flight [s]."""
GYROS: tuple[str, ...] = ("p", "q", "r")
SPREAD = np.zeros(N_STATE)
"""What garbage is added to the states at most: rates, speed, angles, altitude."""
SPREAD[[STATE.p, STATE.q, STATE.r]] = 0.2
SPREAD[STATE.V] = 10.0
SPREAD[[STATE.alpha, STATE.beta, STATE.phi, STATE.theta, STATE.psi]] = 0.06
SPREAD[STATE.h] = 500.0
WAYS: dict[str, tuple[str, LawName | None]] = {
    "ensemble": ("ensemble", None),
    "structured": ("structured", None),
    "indi-rls-protected": ("understudy", "indi-rls-protected"),
    "pid": ("understudy", "pid"),
}
"""Preset, and the law that flies alone."""


class Case(NamedTuple):
    """What happens from ``AT`` on."""

    faults: tuple[AnyFault, ...] = ()
    lost: float = 0.0
    """Share of the states that never arrive, from the start on."""
    garbage: int = 0
    """States to which anything within ``SPREAD`` is added [samples]."""
    blind: int = 0
    """States that are no numbers [samples]."""
    outages: int = 0
    """States that never arrive 3, 7 and 11 s later [samples]."""


def noisy(sd: float, end: float | None = None, gyros: tuple[str, ...] = GYROS) -> tuple[AnyFault, ...]:
    """Return gyros with noise of standard deviation sd [rad/s]."""
    return tuple(SensorNoise(start=AT, end=end, signal=signal, sd=sd) for signal in gyros)  # type: ignore[arg-type]


VANES: tuple[AnyFault, ...] = tuple(
    SensorNoise(start=0.0, signal=signal, sd=sd)  # type: ignore[arg-type]
    for signal, sd in (("V", 0.5), ("alpha", 3e-3), ("beta", 3e-3))
)
"""Air data as noisy as vanes and pitot tubes are, from the start on."""
LATE = Latency(start=AT, seconds=0.15)
REVERSED = Effectiveness(start=AT, surface="elevator", factor=-1.0)

CASES = {
    "nothing": Case(),
    "gyros 0.01 rad/s": Case(noisy(0.01)),
    "gyros 0.05 rad/s": Case(noisy(0.05)),
    "gyros 0.05 rad/s for 2 s": Case(noisy(0.05, AT + 2.0)),
    "pitch gyro 0.05 rad/s": Case(noisy(0.05, gyros=("q",))),
    "garbage for 0.2 s": Case(garbage=20),
    "garbage for 2 s": Case(garbage=200),
    "garbage from then on": Case(garbage=1500),
    "no usable state for 1 s": Case(blind=100),
    "vanes 3 mrad, speed 0.5 m/s": Case(VANES),
    "vanes 3 mrad, speed 0.5 m/s, elevator x -1": Case((*VANES, REVERSED)),
    "vanes 3 mrad, speed 0.5 m/s, commands 150 ms late": Case((*VANES, LATE)),
    "20 % of states lost": Case(lost=0.2),
    "20 % of states lost, garbage for 2 s": Case(lost=0.2, garbage=200),
    "elevator x -1, 5 % of states lost": Case((REVERSED,), 0.05),
    "commands 150 ms late, 2 % of states lost": Case((LATE,), 0.02),
    "commands 150 ms late, 5 % of states lost": Case((LATE,), 0.05),
    "commands 150 ms late, three outages of 0.3 s": Case((LATE,), outages=30),
    "roll gyro stuck, 3 % of states lost": Case((SensorStuck(start=AT, signal="p"),), 0.03),
}


class LossyLink:
    """The aircraft's side in process; where a state is lost, the last command is held."""

    skipped = repeated = 0

    def __init__(self, world: World, samples: int, case: Case, seed: int) -> None:
        rng = np.random.default_rng([seed, 2])
        self.ended, self.x, self.held = "", [world.x.copy()], world.trim_action.copy()
        self._world, self._samples, self._tick = world, samples, 0
        self._lost = rng.random(samples) < case.lost
        self._lost[:5] = False
        first = round(AT / DT)
        for after in (3.0, 7.0, 11.0):
            self._lost[round((AT + after) / DT) :][: case.outages] = True
        self._added = np.zeros((samples, N_STATE))
        self._added[first : first + case.garbage] = rng.uniform(-SPREAD, SPREAD, (case.garbage, N_STATE))
        self._added[first : first + case.blind] = np.nan

    def read(self, timeout: float) -> Sample | None:
        """Return the next state that arrives."""
        while self._tick < self._samples and self._lost[self._tick]:
            self._fly()
        if self._tick == self._samples:
            self.ended = OVER
        elif terminated(self._world.x):
            self.ended = LOST
        if self.ended:
            return None
        return Sample(round(1e6 * DT) * self._tick, 1, self._world.measured + self._added[self._tick])

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Fly one tick."""
        self.held = np.array(action, dtype=float)
        self._fly()

    def _fly(self) -> None:
        self._world.step(self.held)
        self._tick += 1
        self.x.append(self._world.x.copy())

    def say(self, text: str, severity: int) -> None:
        """Say nothing."""

    def diagnosis(self) -> str:
        """Return what is at the other end."""
        return "the plant"


class Flown(NamedTuple):
    """What came of one flight."""

    survived: bool
    nmae: float
    """From ``AT`` on, of what the aircraft really did [%]."""
    alarms: int


def fly(cast: Population, plant: Plant, case: Case, way: str, seed: int, log: Path) -> Flown:
    """Fly one random reference with the sensors of case R3."""
    world = World(Flight(duration=DURATION, faults=case.faults, sensors=R3_SENSORS, seed=seed), plant)
    rows = random_reference(np.random.default_rng(seed), DURATION, float(world.x[STATE.theta]), "evaluation")
    link, (preset, law) = LossyLink(world, len(rows), case, seed), WAYS[way]
    configuration = resolve(preset, None, ("prior=none", "effectiveness=none") if law else (), "none" if law else None)
    flies = load_solo(law) if law else cast
    with Session(link, flies, RecordedReference(rows), configuration, log, overwrite=True) as session:
        (flown,) = session.fly()
    x, begin = np.array(link.x[:-1]), round(AT / DT)
    error = tracking_error(x, rows[: len(x)])[begin:]
    return Flown(flown.outcome == OVER, nmae(error) if len(error) else float("nan"), flown.summary.alarms)


def measure(flights: int, say: Callable[[str], None]) -> dict[str, dict[str, list[Flown]]]:
    """Fly every case in every way."""
    cast, plant = load_population(CAST), Plant()
    flown: dict[str, dict[str, list[Flown]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "f.ulg"
        for name, case in CASES.items():
            flown[name] = {way: [fly(cast, plant, case, way, seed, log) for seed in range(flights)] for way in WAYS}
            say(f"{name}: " + ", ".join(f"{way} {survivors(each)}" for way, each in flown[name].items()))
    return flown


def survivors(flights: list[Flown]) -> str:
    """Return how many of how many survive, and their mean nMAE."""
    kept = [each.nmae for each in flights if each.survived]
    return f"{len(kept)} of {len(flights)}" + (f", {np.mean(kept):.1f} %" if kept else "")


@click.command()
@click.option("--flights", type=click.IntRange(1), default=8, show_default=True, help="Of each case and way.")
def main(flights: int) -> None:
    """Measure and write results/robustness.json."""
    began = time.perf_counter()
    flown = measure(flights, click.echo)
    claims = []
    for way in ("ensemble", "structured"):
        behind = {
            name: sum(peer.survived and not ours.survived for ours, peer in zip(by[way], by["pid"], strict=True))
            for name, by in flown.items()
        }
        claims.append(
            Claim(claim=f"{way}: flights lost that a PID keeps", value=sum(behind.values()), unit="flights", target="0",
                  holds=not any(behind.values()))
        )  # fmt: skip
    result = Result(
        title="Noisy sensors, lost states, garbage, no state",
        command=f"python -m bench.robustness --flights {flights}",
        seconds=round(time.perf_counter() - began, 1),
        runs=flights * len(CASES) * len(WAYS),
        seeds=list(range(flights)),
        claims=claims,
        tables=[
            Table(
                title="Survivors and their mean nMAE from 10 s on; alarms in all flights",
                columns=["case", *WAYS, "alarms: ensemble", "structured"],
                rows=[
                    [name, *(survivors(by[way]) for way in WAYS),
                     *(sum(each.alarms for each in by[way]) for way in ("ensemble", "structured"))]
                    for name, by in flown.items()
                ],
            )
        ],
        notes=[
            "Sensors as in case R3; evaluation references of 25 s; the same seeds for all.",
            "nMAE of what the aircraft does, against a reference that biased sensors let nobody follow closely.",
            "Air data are that noisy from the start on; everything else begins at 10 s.",
            "Garbage adds up to 0.2 rad/s, 10 m/s, 0.06 rad and 500 m to every state: any of them might be true.",
        ],
    )  # fmt: skip
    click.echo(f"{write('robustness', result)}: {result.seconds:.0f} s")


if __name__ == "__main__":
    run(main)
