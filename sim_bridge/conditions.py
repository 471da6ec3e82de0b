"""Where a flight starts."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec

from task.config import Settings
from task.reward import ALTITUDE_LIMIT


class FlightCondition(Settings, frozen=True):
    """A trimmed, wings-level flight: the plant is trimmed to it and the auto-throttle holds its speed.

    The bounds catch what makes no sense, degrees among them; whether there is a trim is found by searching for one.
    """

    altitude: Annotated[float, msgspec.Meta(ge=ALTITUDE_LIMIT, le=20000.0)] = 2000.0
    """Altitude above sea level [m]; lower down a flight counts as lost."""
    speed: Annotated[float, msgspec.Meta(ge=10.0, le=400.0)] = 90.0
    """True airspeed [m/s]."""
    flight_path: Annotated[float, msgspec.Meta(ge=-math.pi / 2, le=math.pi / 2)] = math.radians(-3.0)
    """Flight path angle, positive up [rad]; the reference model starts on a 3 degree descent."""
    heading: Annotated[float, msgspec.Meta(ge=-2 * math.pi, le=2 * math.pi)] = 0.0
    """Heading [rad]."""


NOMINAL = FlightCondition()
"""The thesis's nominal condition: 2000 m, 90 m/s."""
R1 = FlightCondition(altitude=2000.0, speed=150.0)
"""High dynamic pressure."""
R2 = FlightCondition(altitude=10000.0, speed=90.0)
"""Low dynamic pressure."""
