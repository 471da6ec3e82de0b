"""The cases that the classical laws are tuned and measured on: the thesis's, reversals and delays."""

from __future__ import annotations

from typing import NamedTuple

from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.faults import AnyFault, Effectiveness, Latency, SurfaceName
from sim_bridge.presets import F1, F2, F3, F4, F5, F6, R3_GUST, R3_SENSORS
from sim_bridge.sensors import SensorSettings

IDEAL = SensorSettings()
FAULT_AT = 20.0
"""When a surface reverses [s]."""


class Case(NamedTuple):
    """What is flown."""

    faults: tuple[AnyFault, ...] = ()
    condition: FlightCondition = NOMINAL
    sensors: SensorSettings = IDEAL


def reversed_surface(surface: SurfaceName, factor: float = -1.0, start: float = FAULT_AT) -> Case:
    """Return a case in which a surface changes its effect by ``factor`` at ``start`` [s]."""
    return Case((Effectiveness(surface=surface, factor=factor, start=start),))


def delayed(case: Case, seconds: float) -> Case:
    """Return a case with commands that arrive later still [s]."""
    return case._replace(faults=(*case.faults, Latency(seconds=seconds)))


def noisy(case: Case) -> Case:
    """Return a case with the thesis's noise on the sensors, without its biases."""
    return case._replace(sensors=SensorSettings(noise=R3_SENSORS.noise))


CASES: dict[str, Case] = {
    "nominal": Case(),
    "F1": Case(F1),
    "F2": Case(F2),
    "F3": Case(F3),
    "F4": Case(F4),
    "F5": Case(F5),
    "F6": Case(F6),
    "R1": Case(condition=R1),
    "R2": Case(condition=R2),
    "R3": Case(R3_GUST, sensors=R3_SENSORS),
    "elevator x -1": reversed_surface("elevator"),
    "elevator x -0.3": reversed_surface("elevator", -0.3),
    "aileron x -1": reversed_surface("aileron"),
    "rudder x -1": reversed_surface("rudder"),
    "elevator x -1, noise": noisy(reversed_surface("elevator")),
    "aileron x -1, noise": noisy(reversed_surface("aileron")),
    "rudder x -1, noise": noisy(reversed_surface("rudder")),
    "latency 50 ms": delayed(Case(), 0.05),
    "latency 100 ms": delayed(Case(), 0.10),
    "latency 150 ms": delayed(Case(), 0.15),
}
