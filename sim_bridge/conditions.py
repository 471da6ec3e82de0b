"""Where a flight starts."""

from __future__ import annotations

import math

from task.config import Settings


class FlightCondition(Settings, frozen=True):
    """A trimmed, wings-level flight: the plant is trimmed to it and the auto-throttle holds its speed."""

    altitude: float = 2000.0
    """Altitude above sea level [m]."""
    speed: float = 90.0
    """True airspeed [m/s]."""
    flight_path: float = math.radians(-3.0)
    """Flight path angle, positive up [rad]; the reference model starts on a 3 degree descent."""
    heading: float = 0.0
    """Heading [rad]."""


NOMINAL = FlightCondition()
"""The thesis's nominal condition: 2000 m, 90 m/s."""
R1 = FlightCondition(altitude=2000.0, speed=150.0)
"""High dynamic pressure."""
R2 = FlightCondition(altitude=10000.0, speed=90.0)
"""Low dynamic pressure."""
