"""Cases, first the ten of the thesis's table 2, as an aircraft to fly: its trim, what breaks, how it is sensed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from export.network import Network
from export.training.flights import Fleet, Flights
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.faults import AnyFault, Effectiveness, SurfaceName
from sim_bridge.plant import Plant
from sim_bridge.presets import CASES as FAULTS
from sim_bridge.presets import R3_SENSORS
from sim_bridge.schedule import FaultSchedule
from sim_bridge.sensors import Sensors, SensorSettings
from task.errors import UserError
from task.observation import observation
from task.reward import tracking_reward, unsafe
from task.state import N_REFERENCE, STATE

SURFACES: tuple[SurfaceName, ...] = ("elevator", "aileron", "rudder")


class Case(NamedTuple):
    """One row of table 2."""

    name: str
    title: str
    condition: FlightCondition = NOMINAL
    faults: tuple[AnyFault, ...] = ()
    sensors: SensorSettings = SensorSettings()


CASES = (
    Case("nominal", "Nominal"),
    Case("F1", "Iced wings", faults=FAULTS["F1"]),
    Case("F2", "Shifted centre of gravity", faults=FAULTS["F2"]),
    Case("F3", "Saturated aileron", faults=FAULTS["F3"]),
    Case("F4", "Saturated elevator", faults=FAULTS["F4"]),
    Case("F5", "Broken elevator", faults=FAULTS["F5"]),
    Case("F6", "Jammed rudder", faults=FAULTS["F6"]),
    Case("R1", "High dynamic pressure", condition=R1),
    Case("R2", "Low dynamic pressure", condition=R2),
    Case("R3", "Gust, biased and noisy sensors", faults=FAULTS["R3"], sensors=R3_SENSORS),
)
REVERSED = tuple(
    Case(f"{surface}_reversed", f"Reversed {surface}", faults=(Effectiveness(surface=surface, factor=-1.0),))
    for surface in SURFACES
)
"""Beyond table 2: what only a member bred for it survives."""
NOMINAL_CASE = CASES[0].name
IDEAL = SensorSettings()


def choose(names: str) -> tuple[Case, ...]:
    """Return the cases of a comma-separated list, in the order of table 2; raise UserError for an unknown name."""
    wanted = {name.strip() for name in names.split(",")}
    known = [case.name for case in CASES]
    unknown = sorted(wanted - set(known))
    if unknown:
        raise UserError(f"--cases: no case '{unknown[0]}'; expected some of {', '.join(known)}")
    return tuple(case for case in CASES if case.name in wanted)


class CasePlant(Plant):
    """An aircraft that breaks as its case says, and shows what its sensors read."""

    def __init__(self, case: Case) -> None:
        """Take the first case; ``case`` and ``seed`` of the sensors' noise may be set between flights."""
        self.case = case
        self.seed = 0
        super().__init__()

    def reset(self, condition: FlightCondition = NOMINAL, *args: object, **start: object) -> np.ndarray:
        """Start a flight (:meth:`Plant.reset`); return the first readings (12,)."""
        x = super().reset(condition, *args, **start)  # type: ignore[arg-type]
        self._schedule = FaultSchedule(self.case.faults)
        self._sensors = Sensors(self.case.sensors, np.random.default_rng(self.seed))
        self._sensed = self.case.sensors != IDEAL
        self.truth = [x.copy()] if self._sensed else []
        """Every state so far (12,), kept where the readings are not the state."""
        self._schedule.apply(self, 0.0, self._sensors)
        return self._sensors.measure(x)

    def step(self, action: np.ndarray) -> np.ndarray:
        """Advance by one sample with deflections (3,) [rad]; return the readings (12,)."""
        self._schedule.apply(self, self.time, self._sensors)
        x = super().step(action)
        if not self._sensed:
            return x
        self.truth.append(x.copy())
        return self._sensors.measure(x)


class CaseFleet(Fleet):
    """A fleet whose aircraft fly one case after another; every actor meets the same noise on the same reference."""

    apart = True

    def __init__(self, case: Case = CASES[0]) -> None:
        """Start with one aircraft in ``case``."""
        super().__init__(case.condition)
        self.plants = [CasePlant(case)]
        self.take(case)

    def take(self, case: Case) -> None:
        """Fly ``case`` from now on."""
        self.case, self.condition = case, case.condition
        for plant in self.plants:
            assert isinstance(plant, CasePlant)
            plant.case = case
        self.plants[0].reset(case.condition)
        self.theta_trim = float(self.plants[0].trim.x[STATE.theta])

    def fly_case(
        self, network: Network, parameters: np.ndarray, references: np.ndarray, seeds: Sequence[int]
    ) -> Flights:
        """Fly actors (P, K) on references (E, T + 1, 3) [rad]; ``seeds`` (E,) are of the sensors' noise.

        Observation, reward and ``unsafe`` are of the true state; whether a flight is lost is judged by the
        readings, as the flights of training do.
        """
        P, E = len(parameters), len(references)
        self.plants += [CasePlant(self.case) for _ in range(P * E - len(self.plants))]
        for i, plant in enumerate(self.plants):
            assert isinstance(plant, CasePlant)
            plant.seed = seeds[i % E]
        flights = self.fly(network, parameters, references)
        return flights if self.case.sensors == IDEAL else self._as_it_was(flights, references)

    def _as_it_was(self, flights: Flights, references: np.ndarray) -> Flights:
        """Return flights with the readings replaced by the states that were flown."""
        seen, reward, danger = flights.observation.copy(), flights.reward.copy(), flights.unsafe.copy()
        P, E = flights.length.shape
        for i, (p, e) in enumerate(np.ndindex(P, E)):
            plant = self.plants[i]
            assert isinstance(plant, CasePlant)
            truth = np.array(plant.truth)
            n = min(int(flights.length[p, e]), int(np.isfinite(truth).all(axis=1).sum()) - 1)
            s = observation(truth[: n + 1], references[e, : n + 1])
            read = tracking_reward(seen[1 : n + 1, p, e, :N_REFERENCE])
            reward[:n, p, e] += tracking_reward(s[1:, :N_REFERENCE]) - read
            danger[:n, p, e] = unsafe(truth[1 : n + 1])
            seen[: n + 1, p, e] = s
        return flights._replace(observation=seen, reward=reward, unsafe=danger)
