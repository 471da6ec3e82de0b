"""Tunes the classical laws: what they know of the healthy aircraft, their gains, and their estimate of effectiveness.

``python -m bench.tune_laws`` writes ``runtime/laws/citation.json``, the same file every time. Nelder-Mead, loop by
loop, on the thesis's base reference over 40 s, flown in the thesis's cases with 40 ms of delay added as a margin.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import click
import numpy as np
from msgspec.structs import replace
from scipy.optimize import minimize

from bench.law_cases import CASES, Case, delayed, noisy, reversed_surface
from runtime.laws.catalogue import SETTINGS, LawSettings, make_law
from runtime.laws.effectiveness import EstimateSettings
from runtime.laws.indi import INDIGains
from runtime.laws.law import Airframe, Law, air_density
from runtime.laws.pid import PIDGains
from sim_bridge.conditions import NOMINAL, R1, R2
from sim_bridge.plant import Plant
from sim_bridge.schedule import FaultSchedule
from sim_bridge.sensors import Sensors
from task.config import to_json
from task.limits import DEFLECTION_LIMIT, DT
from task.metrics import nmae
from task.observation import tracking_error
from task.reference import base_reference
from task.reward import terminated
from task.state import N_ACTION, N_STATE, STATE
from understudy import run

DURATION = 40.0
"""Of a tuning flight [s]."""
MARGIN = 0.04
"""Delay that is added to every tuning flight of the gains [s]."""
LOST = 100.0
"""Cost of a flight that is lost at its end, and twice that at its start; in percent, like nMAE."""
TUNED_ON = ("nominal", "F5", "R2", "R3")
"""Cases of the gains; the others are left to judge by."""
STEP = math.radians(0.5)
"""Deflection that the effectiveness is measured with, and sideslip that the dihedral effect is [rad]."""

START_PID = PIDGains(theta=(2.0, 2.0, 0.5), phi=(2.2, 0.5, 0.3), beta=(1.6, 3.0, 0.3), schedule=(1.0, 1.0, 0.5))
START_INDI = INDIGains(attitude=(2.0, 2.0, 1.5), rate=(6.0, 6.0, 3.0), cutoff=15.0)
START_ESTIMATE = EstimateSettings(p0=1e6, kappa=0.99, least=0.1, most=5.0)


def fly(plant: Plant, law: Law, case: Case, duration: float = DURATION) -> float:
    """Return the nMAE [%] of a law on the base reference, or what a lost flight costs."""
    x = plant.reset(case.condition)
    law.reset()
    schedule, sensors = FaultSchedule(case.faults), Sensors(case.sensors, np.random.default_rng(0))
    rows = base_reference(duration, float(plant.trim.x[STATE.theta]))
    states = np.zeros((len(rows), N_STATE))
    for k, row in enumerate(rows):
        states[k] = x
        if k % 10 == 0 and terminated(x):
            return LOST * (2.0 - k / len(rows))
        schedule.apply(plant, k * DT, sensors)
        command = law.steer(sensors.measure(x), row).clip(-DEFLECTION_LIMIT, DEFLECTION_LIMIT)
        law.sent(command)
        x = plant.step(command)
    return nmae(tracking_error(states, rows))


def airframe(plant: Plant) -> Airframe:
    """Return the healthy aircraft: trim at the three conditions of the thesis, all else at the nominal one."""
    conditions = (NOMINAL, R1, R2)
    pressures = [0.5 * air_density(c.altitude) * c.speed**2 for c in conditions]
    elevators = []
    for condition in conditions:
        plant.reset(condition)
        elevators.append(float(plant.trim.action[0]))
    powers = np.vander([pressures[0] / p for p in pressures], 3, increasing=True)
    trim = np.linalg.solve(powers, elevators)
    effect = np.zeros((3, N_ACTION))
    for j in range(N_ACTION):
        for sign in (1.0, -1.0):
            plant.reset(NOMINAL)
            action = plant.trim.action.copy()
            action[j] += sign * STEP
            plant.step(action)
            effect[:, j] += sign * plant.step(action)[: STATE.r + 1] / (2.0 * STEP * DT)
    rows = np.round(effect, 2) + 0.0
    roll = 0.0
    for sign in (1.0, -1.0):
        x = plant.reset(NOMINAL).copy()
        x[STATE.beta] += sign * STEP
        plant.reset(NOMINAL, x=x)
        roll += sign * float(plant.step(plant.trim.action)[STATE.p]) / (2.0 * STEP * DT)
    return Airframe(
        dynamic_pressure=round(pressures[0], 1),
        trim_elevator=tuple(round(float(c), 6) for c in trim),  # type: ignore[arg-type]
        effectiveness=tuple(tuple(row) for row in rows.tolist()),  # type: ignore[arg-type]
        dihedral=round(roll, 2),
    )


def search(
    cost: Callable[[np.ndarray], float], start: Sequence[float], evaluations: int, spread: float = 0.3
) -> tuple[np.ndarray, float]:
    """Return the best of Nelder-Mead from ``start`` and its cost."""
    first = np.asarray(start, dtype=float)
    simplex = np.vstack([first, first + spread * np.eye(len(first))])
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 0.01, "fatol": 1e-4}
    found = minimize(cost, first, method="Nelder-Mead", options=options)
    return found.x, float(found.fun)


class Tuner:
    """One plant, and the settings as far as they are found."""

    def __init__(self, settings: LawSettings, evaluations: int) -> None:
        self.plant = Plant()
        self.settings = settings
        self.evaluations = evaluations
        self.flights = 0

    def mean(self, name: str, settings: LawSettings, cases: Sequence[Case]) -> float:
        """Return the mean cost of a law over cases [%]."""
        law = make_law(name, settings)  # type: ignore[arg-type]
        self.flights += len(cases)
        return float(np.mean([fly(self.plant, law, case) for case in cases]))

    def improve(self, law: str, what: str, start: Sequence[float], put: Callable[[np.ndarray], LawSettings]) -> None:
        """Tune some numbers of the settings; ``put`` returns the settings with them."""
        cases = [delayed(CASES[name], MARGIN) for name in TUNED_ON]
        found, cost = search(lambda z: self.mean(law, put(z), cases), start, self.evaluations)
        self.settings = put(found)
        click.echo(f"{law} {what}: {cost:.3f} % after {self.flights} flights")

    def pid(self) -> None:
        """Tune the three loops one after another: log of P, I, D, and the power of the scheduling."""
        for loop, name in enumerate(("theta", "phi", "beta")):
            gains = self.settings.pid

            def put(z: np.ndarray, loop: int = loop, name: str = name, gains: PIDGains = gains) -> LawSettings:
                schedule = list(gains.schedule)
                schedule[loop] = rounded(z[3])
                new = {name: tuple(rounded(g) for g in np.exp(z[:3])), "schedule": tuple(schedule)}
                return replace(self.settings, pid=replace(gains, **new))

            self.improve("pid", name, [*np.log(getattr(gains, name)), gains.schedule[loop]], put)

    def indi(self) -> None:
        """Tune the loops of each axis, then the filter: log of all."""
        for place, rate in ((0, 1), (1, 0), (2, 2)):
            gains = self.settings.indi

            def put(z: np.ndarray, place: int = place, rate: int = rate, gains: INDIGains = gains) -> LawSettings:
                k_attitude, k_rate = list(gains.attitude), list(gains.rate)
                k_attitude[place], k_rate[rate] = (rounded(k) for k in np.exp(z[:2]))
                new = {"attitude": tuple(k_attitude), "rate": tuple(k_rate)}
                return replace(self.settings, indi=replace(gains, **new, cutoff=rounded(np.exp(z[2]))))

            start = np.log([gains.attitude[place], gains.rate[rate], gains.cutoff])
            self.improve("indi", ("theta", "phi", "beta")[place], list(start), put)

    def estimate(self) -> None:
        """Choose P0 and kappa for the sign-free estimate from a grid: each surface reversed, ideal and noisy."""
        reversals = [reversed_surface(s, f, 10.0) for s in ("elevator", "aileron", "rudder") for f in (-1.0, -0.3)]
        cases = [*reversals, *map(noisy, reversals), CASES["nominal"], CASES["F5"], CASES["R2"], CASES["R3"]]
        best = math.inf
        for p0 in (1e4, 1e5, 1e6, 1e7, 1e8):
            for kappa in (0.98, 0.99, 0.995, 0.998):
                tried = replace(self.settings, estimate=replace(self.settings.estimate, p0=p0, kappa=kappa))
                cost = self.mean("indi-rls-signfree", tried, cases)
                if cost < best:
                    best, self.settings = cost, tried
                    click.echo(f"indi-rls-signfree P0 {p0:g} kappa {kappa:g}: {cost:.2f} %")


def rounded(value: float) -> float:
    """Return three significant digits: more would pretend."""
    return float(f"{value:.3g}")


@click.command()
@click.option(
    "--evaluations",
    type=click.IntRange(1),
    default=25,
    show_default=True,
    help="Cost evaluations for each loop and round.",
)
@click.option(
    "--rounds", type=click.IntRange(1), default=2, show_default=True, help="How often all loops are gone through."
)
@click.option("--out", type=Path, default=SETTINGS, show_default=True)
def main(evaluations: int, rounds: int, out: Path) -> None:
    """Tune the laws and write their settings."""
    began = time.monotonic()
    start = LawSettings(airframe=airframe(Plant()), pid=START_PID, indi=START_INDI, estimate=START_ESTIMATE)
    tuner = Tuner(start, evaluations)
    for _ in range(rounds):
        tuner.pid()
        tuner.indi()
    tuner.estimate()
    out.write_bytes(to_json(tuner.settings))
    click.echo(f"{tuner.flights} flights in {time.monotonic() - began:.0f} s: {out}")


if __name__ == "__main__":
    run(main)
