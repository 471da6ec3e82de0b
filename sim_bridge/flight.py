"""What the bridge needs to know of a flight; the runtime never sees it."""

from __future__ import annotations

from typing import Annotated

import msgspec

from sim_bridge.air import Air
from sim_bridge.conditions import FlightCondition
from sim_bridge.faults import AnyFault
from sim_bridge.sensors import SensorSettings
from task.config import Settings


class Flight(Settings, frozen=True):
    """One flight of the aircraft: how long, from where, in what air, with which sensors and faults."""

    duration: Annotated[float, msgspec.Meta(ge=0.01, le=36000.0)] = 100.0
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
