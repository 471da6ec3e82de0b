"""The flights that breeding draws, and what a flight costs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from export.cast.cases import IDEAL, Case
from export.cast.config import RobustSettings, TrialSettings
from export.cast.flights import Flown, Trial
from sim_bridge.conditions import FlightCondition
from sim_bridge.faults import AnyFault, Effectiveness, Latency, SurfaceName
from sim_bridge.plant import Plant
from sim_bridge.presets import R3_SENSORS
from sim_bridge.sensors import SensorSettings
from task.limits import DT
from task.reference import n_samples, random_reference
from task.state import STATE

SURFACES: tuple[SurfaceName, ...] = ("elevator", "aileron", "rudder")


class Drawer:
    """Draws trials from one stream of chance."""

    def __init__(self, settings: TrialSettings, plant: Plant) -> None:
        """``plant`` only says where each condition's trim is; it is reset at every new condition."""
        self._settings, self._plant = settings, plant
        self._pitch: dict[FlightCondition, float] = {}

    def theta_trim(self, condition: FlightCondition) -> float:
        """Return the pitch of a condition's trim [rad]."""
        if condition not in self._pitch:
            self._plant.reset(condition)
            self._pitch[condition] = float(self._plant.trim.x[STATE.theta])
        return self._pitch[condition]

    def reference(self, rng: np.random.Generator, condition: FlightCondition) -> np.ndarray:
        """Return the beginning of a random evaluation reference (T, 3) [rad]."""
        drawn = random_reference(rng, self._settings.period, self.theta_trim(condition))
        return drawn[: n_samples(self._settings.duration)]

    def trials(self, rng: np.random.Generator, case: Case, count: int, sudden: bool) -> list[Trial]:
        """Return trials of a case; ``sudden`` ones break in flight and are handed over after the decision's time."""
        settings, drawn = self._settings, []
        for _ in range(count):
            reference = self.reference(rng, case.condition)
            onset, seed = rng.uniform(*settings.onset), int(rng.integers(2**31))
            if sudden:
                drawn.append(Trial(case, reference, onset, onset + settings.decision, seed))
            else:
                drawn.append(Trial(case, reference, 0.0, 0.0, seed))
        return drawn


def random_case(rng: np.random.Generator, settings: RobustSettings, conditions: Sequence[FlightCondition]) -> Case:
    """Return an aircraft that the single robust policy must fly."""
    low, high = np.log(settings.effectiveness)
    faults: list[AnyFault] = [
        Effectiveness(surface=surface, factor=float(np.exp(rng.uniform(low, high)))) for surface in SURFACES
    ]
    faults.append(Latency(seconds=float(rng.uniform(*settings.latency))))
    noisy = settings.noisy and rng.random() < 0.5
    sensors = SensorSettings(noise=R3_SENSORS.noise) if noisy else IDEAL
    condition = conditions[int(rng.integers(len(conditions)))]
    return Case(name="randomised", faults=tuple(faults), condition=condition, sensors=sensors)


def random_conditions(rng: np.random.Generator, settings: RobustSettings) -> list[FlightCondition]:
    """Return the trims of the robust policy's flights."""
    return [
        FlightCondition(altitude=float(rng.uniform(*settings.altitude)), speed=float(rng.uniform(*settings.speed)))
        for _ in range(settings.trims)
    ]


def costs(flown: Flown, trials: Sequence[Trial], settings: TrialSettings) -> np.ndarray:
    """Return what each flight costs [% nMAE], shape (P, E), from the handover on.

    A flight that survives costs its nMAE and the part of Sm below ``smooth``; a lost one costs ``lost`` to twice
    ``lost``, the more the earlier. Both keep the order that selection needs without a reward of their own.
    """
    since = np.array([round(trial.handover / DT) for trial in trials])
    samples = trials[0].reference.shape[0]
    rough = np.maximum(0.0, settings.smooth - flown.smoothness(since))
    survived = np.nan_to_num(flown.nmae(since), nan=math.inf) + settings.smooth_weight * rough
    return np.where(flown.lost, settings.lost * (2.0 - flown.length / samples), survived)
