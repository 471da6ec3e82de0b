"""What the bridge needs to know of a flight; the runtime never sees it."""

from __future__ import annotations

from typing import Annotated

import msgspec

from sim_bridge.air import Air
from sim_bridge.conditions import FlightCondition
from sim_bridge.faults import AnyFault, describe
from sim_bridge.sensors import SensorSettings
from task.config import Settings

SHORTEST, LONGEST = 0.01, 36000.0
"""Of flights [s]: one sample, and ten hours."""


class Flight(Settings, frozen=True):
    """One flight of the aircraft: how long, from where, in what air, with which sensors and faults."""

    duration: Annotated[float, msgspec.Meta(ge=SHORTEST, le=LONGEST)] = 100.0
    """How long it lasts [s]."""
    condition: FlightCondition = FlightCondition()
    """The trimmed flight that it starts from."""
    air: Air = Air()
    """Steady wind and turbulence; gusts are faults."""
    sensors: SensorSettings = SensorSettings()
    """Noise, bias and delay of what is sent; ideal by default."""
    faults: tuple[AnyFault, ...] = ()
    """What breaks, when, how far and how fast; they combine in this order."""
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    """Seed of everything random in it: sensor noise and turbulence."""

    def beyond_its_end(self) -> list[str]:
        """Return, in words, the faults that would begin when the flight is over already."""
        return [
            f"faults[{i}].start: expected less than the flight's duration of {self.duration:g} s, "
            f"got {fault.start:g} s ({describe(fault)})"
            for i, fault in enumerate(self.faults)
            if fault.start >= self.duration
        ]
