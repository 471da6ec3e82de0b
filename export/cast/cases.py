"""What can happen to the aircraft, as cases that members are bred for and judged by."""

from __future__ import annotations

from typing import Any

import msgspec

from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.faults import AnyFault
from sim_bridge.presets import F1, F2, F3, F4, F5, F6, R3_GUST, R3_SENSORS
from sim_bridge.sensors import SensorSettings
from task.config import Settings

IDEAL = SensorSettings()


class Case(Settings, frozen=True):
    """A flight condition, sensors and faults whose times count from the onset."""

    name: str
    faults: tuple[AnyFault, ...] = ()
    """What breaks; ``start`` and ``end`` [s] are counted from the onset."""
    condition: FlightCondition = NOMINAL
    sensors: SensorSettings = IDEAL

    def begun(self, onset: float) -> tuple[AnyFault, ...]:
        """Return the faults on a flight's clock, for an onset at ``onset`` [s]."""
        return tuple(_shifted(fault, onset) for fault in self.faults)


def _shifted(fault: AnyFault, onset: float) -> AnyFault:
    times: dict[str, Any] = {"start": fault.start + onset}
    if fault.end is not None:
        times["end"] = fault.end + onset
    return msgspec.structs.replace(fault, **times)


EASY: tuple[Case, ...] = (
    Case(name="nominal"),
    Case(name="F1", faults=F1),
    Case(name="F2", faults=F2),
    Case(name="F3", faults=F3),
    Case(name="F4", faults=F4),
    Case(name="F5", faults=F5),
    Case(name="F6", faults=F6),
    Case(name="R1", condition=R1),
    Case(name="R2", condition=R2),
    Case(name="R3", faults=R3_GUST, sensors=R3_SENSORS),
)
"""The thesis's table 2; they hold from the start of a flight."""
