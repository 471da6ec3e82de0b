"""The air that a flight flies in."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from task.config import Settings

Turbulence = Literal["none", "light", "moderate", "severe"]

DRYDEN = {"light": (7.72, 3), "moderate": (15.43, 4), "severe": (23.15, 6)}
"""Of each level: wind at 20 ft [m/s] (15, 30, 45 knots, MIL-F-8785C) and JSBSim's index of severity aloft."""


Wind = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]
"""Of steady winds and gusts: as fast as a jet stream and no faster [m/s]."""


class Air(Settings, frozen=True):
    """Steady wind and turbulence; still air by default."""

    wind_north: Wind = 0.0
    """Steady wind, the part that blows towards north [m/s]."""
    wind_east: Wind = 0.0
    """Steady wind, the part that blows towards east [m/s]."""
    turbulence: Turbulence = "none"
    """Dryden turbulence (MIL-F-8785C, as JSBSim has it)."""


STILL_AIR = Air()
"""No wind, no turbulence."""
