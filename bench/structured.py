"""What the structured adaptation saves and what it costs, flown in process on the plant.

``python -m bench.structured`` flies a cast of two linear laws, their mirrors and a crossed one through reversed, weak,
crossed and late surfaces and other faults, with ideal sensors and with gyro noise, beside the first law alone and the
right member from the fault on, and writes ``results/structured.json``.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from bench.structured_cases import (
    CASES,
    FAULT_AT,
    GYRO,
    HEALTHY,
    HELD_OUT,
    REVERSALS,
    TURBULENT,
    Case,
    Condition,
    laws,
    linear_cast,
    trimmed,
)
from export.folder import write_population
from export.prior import model_prior
from export.rates import rate_model
from runtime.config import resolve
from runtime.link import LOST, OVER, Sample
from runtime.population import Population as Loaded
from runtime.population import load_population
from runtime.reference import RecordedReference
from runtime.session import Session
from sim_bridge.air import Air
from sim_bridge.faults import AnyFault
from sim_bridge.plant import Plant
from sim_bridge.schedule import FaultSchedule
from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.metrics import nmae
from task.observation import observation, tracking_error
from task.reference import random_reference
from task.results import Claim, Result, Table, write
from task.reward import terminated
from task.state import N_IDENTIFIED, STATE


class Flight(NamedTuple):
    """What came of one flight."""

    survived: bool
    nmae: float
    """From the fault to the end [%]; up to the loss when it was lost."""
    alarm: float
    """From the fault to the first alarm after it [s]; NaN without."""
    cast: float
    """From the fault until the right member flies for good [s]; NaN when it does not at the end."""
    alarms: int
    switches: int
    casts: tuple[tuple[float, str], ...] = ()
    """Every switch: time from the fault [s], member."""


class PlantLink:
    """The plant as a link in lockstep, with faults and gyros that are noisy."""

    skipped = repeated = 0

    def __init__(self, plant: Plant, faults: tuple[AnyFault, ...], condition: Condition, seed: int) -> None:
        self.ended = ""
        self._plant, self._condition = plant, condition
        self._rng = np.random.default_rng([seed, 1])
        self._ticks = round(condition.duration / DT)
        self._tick = 0
        self._schedule = FaultSchedule(faults)
        self.oracle: Callable[[np.ndarray], np.ndarray] | None = None
        """Who flies from the fault on, in place of what is written; from the measured state to a command."""
        plant.reset(condition.start, air=Air(turbulence=condition.turbulence), seed=seed)
        self.x = [plant.x[:N_IDENTIFIED].copy()]
        self._measured = self.x[0]

    def read(self, timeout: float) -> Sample | None:
        """Return the measured state."""
        if self._tick >= self._ticks:
            self.ended = OVER
        elif terminated(self._plant.x):
            self.ended = LOST
        if self.ended:
            return None
        x = self._plant.x.copy()
        x[: STATE.V] += self._condition.noise * self._rng.standard_normal(3)
        self._measured = x
        return Sample(round(1e6 * DT) * self._tick, 1, x)

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Step the plant."""
        command = np.asarray(action, dtype=float)
        if self.oracle is not None and self._tick * DT >= FAULT_AT:
            command = self.oracle(self._measured)
        self._schedule.apply(self._plant, self._tick * DT)
        self._plant.step(command)
        self._tick += 1
        self.x.append(self._plant.x[:N_IDENTIFIED].copy())

    @property
    def tick(self) -> int:
        """Return the sample that is flown."""
        return self._tick

    def say(self, text: str, severity: int) -> None:
        """Say nothing."""

    def diagnosis(self) -> str:
        """Return what is at the other end."""
        return "the plant"

    def close(self) -> None:
        """Leave the plant to the next flight."""


class Bench:
    """One plant, one cast, one folder for logs."""

    def __init__(self, cast: Loaded, folder: Path, cache: Path) -> None:
        self._cast, self._log, self._plant, self._cache = cast, folder / "flight.ulg", Plant(), cache
        self.flown = 0
        """Flights so far."""

    def flight(self, fault: str, condition: Condition, seed: int, method: str) -> Flight:
        """Return the flight of a case, from the cache when the same one was flown with the same settings."""
        settings = resolve("structured").adaptation if method == "structured" else None
        asked = repr((CASES[fault], condition, seed, method, settings))
        kept = self._cache / f"{hashlib.sha256(asked.encode()).hexdigest()[:16]}.json"
        self.flown += 1
        if kept.exists():
            return Flight(**json.loads(kept.read_text()))
        flown = self.fly(CASES[fault], condition, seed, method)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(flown._asdict()))
        return flown

    def fly(self, case: Case, condition: Condition, seed: int, method: str) -> Flight:
        """Fly one reference; method: ``structured``, ``alone`` (the champion) or ``oracle``.

        The oracle flies the right member from the moment of the fault.
        """
        link = PlantLink(self._plant, case.faults, condition, seed)
        rows = random_reference(
            np.random.default_rng(seed), condition.duration, float(link.x[0][STATE.theta]), condition.family
        )
        if method == "oracle":
            gains, trim = laws()[case.right], trimmed(case.right)

            def right(x: np.ndarray) -> np.ndarray:
                command = trim + gains @ observation(x, rows[link.tick])
                return np.clip(command, ACTION_LOW, ACTION_HIGH)

            link.oracle = right
        events: list[tuple[float, str]] = []

        def heard(line: str) -> None:
            at, _, text = line.partition(" s: ")
            if text.startswith("alarm") or " switch to " in text:
                events.append((float(at) - FAULT_AT, text))

        configuration = resolve("structured") if method == "structured" else resolve("understudy", switch="none")
        with Session(link, self._cast, RecordedReference(rows), configuration, self._log, heard) as session:
            (flown,) = session.fly()
        x = np.array(link.x[:-1])
        error = tracking_error(x, rows[: len(x)])[round(FAULT_AT / DT) :]
        alarms = [at for at, text in events if text.startswith("alarm") and at >= 0.0]
        switches = [(at, text.split(" switch to ")[1].split(":")[0]) for at, text in events if " switch to " in text]
        there = [at for at, member in switches[-1:] if member == case.right]
        return Flight(
            flown.outcome == OVER,
            nmae(error) if len(error) else float("nan"),
            alarms[0] if alarms else float("nan"),
            there[0] if there else float("nan"),
            flown.summary.alarms,
            flown.summary.switches,
            tuple(switches),
        )


def spread(values: list[float]) -> str:
    """Return median and worst of the finite values, as text."""
    known = [v for v in values if np.isfinite(v)]
    return f"{np.median(known):.2f} ({max(known):.2f})" if known else "-"


METHODS = ("alone", "structured", "oracle")


def fault_rows(bench: Bench, cases: list[str], conditions: dict[str, Condition], references: int) -> list[list[object]]:
    """Return one row for each fault and condition."""
    rows: list[list[object]] = []
    for fault in cases:
        for name, condition in conditions.items():
            flown = {
                method: [bench.flight(fault, condition, HELD_OUT + i, method) for i in range(references)]
                for method in METHODS
            }
            ours = flown["structured"]
            rows.append([
                fault, name,
                *(f"{sum(f.survived for f in flights)} of {references}" for flights in flown.values()),
                *(spread([f.nmae for f in flights if f.survived]) for flights in flown.values()),
                spread([f.alarm for f in ours]), spread([f.cast for f in ours]),
                sum(f.switches for f in ours),
            ])  # fmt: skip
            click.echo("  ".join(str(cell) for cell in rows[-1]))
    return rows


MODERATE = "moderate"


def quiet_rows(bench: Bench, references: int) -> list[list[object]]:
    """Return one row for each condition of a healthy aircraft: alarms, switches and what they did."""
    rows: list[list[object]] = []
    for name, case in HEALTHY.items():
        for noise in (0.0, GYRO):
            condition = case._replace(noise=noise)
            ours, alone = (
                [bench.flight("none", condition, HELD_OUT + i, method) for i in range(references)]
                for method in ("structured", "alone")
            )
            rows.append([
                name, "ideal" if noise == 0.0 else "gyro noise", round(references * condition.duration / 60.0, 2),
                sum(f.alarms for f in ours), sum(f.switches for f in ours),
                f"{sum(f.survived for f in alone)} of {references}", f"{sum(f.survived for f in ours)} of {references}",
                spread([f.nmae for f in alone if f.survived]), spread([f.nmae for f in ours if f.survived]),
            ])  # fmt: skip
            click.echo("  ".join(str(cell) for cell in rows[-1]))
    return rows


def count(rows: list[list[object]], column: int) -> tuple[int, int]:
    """Return the sum of a column of "n of m" over rows, and of m."""
    pairs = [str(row[column]).split(" of ") for row in rows]
    return sum(int(n) for n, _ in pairs), sum(int(m) for _, m in pairs)


@click.command()
@click.option("--references", default=2, show_default=True, help="Random references for each fault and condition.")
@click.option("--quiet", default=1, show_default=True, help="Faultless flights of 40 s for each condition.")
@click.option("--cache", type=click.Path(path_type=Path), default=Path("runs/bench_structured"), show_default=True,
              help="Every flight is kept here, so that an interrupted run goes on.")  # fmt: skip
def main(references: int, quiet: int, cache: Path) -> None:
    """Measure survival, times and false alarms; write results/structured.json."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        write_population(linear_cast(), model_prior(), Path(folder) / "cast", rates=rate_model())
        bench = Bench(load_population(Path(folder) / "cast"), Path(folder), cache)
        still = {"ideal": Condition(), "gyro noise": Condition(noise=GYRO)}
        faults = fault_rows(bench, list(CASES), still, references)
        click.echo("turbulence")
        rough = {f"{level} turbulence, gyro noise": Condition(GYRO, level) for level in ("light", "moderate")}
        turbulent = fault_rows(bench, TURBULENT, rough, references)
        healthy = quiet_rows(bench, quiet)
    survived, flights = count(faults, 3)
    possible, _ = count(faults, 4)
    reversals = [row for row in faults if row[0] in REVERSALS]
    saved, of = count(reversals, 3)
    calm = [row for row in healthy if MODERATE not in str(row[0])]
    alarms, minutes = sum(int(str(row[3])) for row in calm), sum(float(str(row[2])) for row in calm)
    columns = [
        "fault at 5 s", "condition", "survive: alone", "structured", "oracle", "nMAE %: alone", "structured", "oracle",
        "alarm [s]", "right member [s]", "switches",
    ]  # fmt: skip
    result = Result(
        title="Structured adaptation: surfaces that are reversed, weak, crossed or late",
        command=f"python -m bench.structured --references {references} --quiet {quiet}",
        seconds=round(time.perf_counter() - began, 1),
        runs=bench.flown,
        seeds=[HELD_OUT + i for i in range(max(references, quiet))],
        claims=[
            Claim(claim="reversed surfaces survived, still air", value=f"{saved} of {of}", target="all",
                  holds=saved == of),
            Claim(claim="all faults survived, still air", value=f"{survived} of {flights}",
                  target=f"the oracle's {possible}", holds=survived >= possible),
            Claim(claim="the same without adaptation", value=f"{count(faults, 2)[0]} of {flights}"),
            Claim(claim="alarms without a fault, still air and light turbulence", value=alarms,
                  unit=f"in {minutes:.3g} min", target="1 in 10 min", holds=alarms <= minutes / 10.0),
        ],
        tables=[
            Table(title="Still air, evaluation references of 15 s", columns=columns, rows=faults),
            Table(title="Turbulence (Dryden), evaluation references of 15 s", columns=columns, rows=turbulent),
            Table(title="Faultless flights of 40 s",
                  columns=["condition", "sensors", "minutes", "alarms", "switches", "survive: alone", "structured",
                           "nMAE %: alone", "structured"], rows=healthy),
        ],
        notes=[
            "The cast: two linear laws on the policy's seven observations, the mirrors of both, and the first one with "
            "aileron and rudder exchanged. It shows the mechanism, not a trained population.",
            "References, noise and turbulence are held out: the preset was tuned on other seeds.",
            "nMAE: from the fault to the end, survivors only, median (worst). Times: from the fault, median (worst).",
            "The oracle flies the right member from the moment of the fault; it may be another than the best one.",
            "Ideal sensors, or gyro noise of 6.3e-4 rad/s on p, q, r; no other sensor errors.",
        ],
    )  # fmt: skip
    click.echo(f"{write('structured', result)}: {result.seconds:.0f} s")


if __name__ == "__main__":
    main()
