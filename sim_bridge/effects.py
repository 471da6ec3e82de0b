"""What can change in the aircraft or the air while it flies: typed setters over JSBSim's properties."""

from __future__ import annotations

import math
from typing import Any

from sim_bridge.air import DRYDEN, Turbulence
from sim_bridge.aircraft.build import BALLAST

FT = 0.3048
"""One foot [m]."""
INCH = 0.0254
"""One inch [m]."""
_NO_TURBULENCE, _MILSPEC_TURBULENCE = 0, 3
"""JSBSim's numbers for its models of turbulence."""
CLEAN_ALPHA_MAX = math.radians(11.0)
"""Largest angle of attack of the clean wing in the reference [rad]; 70 % of it is where its iced lift freezes."""
ENGINE_ARM = 1.5
"""Distance of an engine from the plane of symmetry [m]: an estimate, not identified."""
NO_ALPHA_LIMIT = 1.0
"""Angle of attack of a clean wing's icing limit [rad]: never reached."""


class Effects:
    """Effects on one JSBSim instance; every setter may be called at any time in flight."""

    def __init__(self, fdm: Any) -> None:
        """Hold the properties of ``fdm``; the aircraft is left as it is."""
        node = fdm.get_property_manager().get_node
        self._gust = tuple(node(f"atmosphere/gust-{axis}-fps") for axis in ("north", "east", "down"))
        self._upright = node("atmosphere/gust-keeps-lift-upright")
        self._turbulence = node("atmosphere/turb-type")
        self._wind_at_20ft = node("atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps")
        self._severity = node("atmosphere/turbulence/milspec/severity")
        self._ballast = node("inertia/pointmass-location-X-inches")
        self._drag = node("icing/drag-coefficient")
        self._alpha_max = node("icing/alpha-max-rad")
        self._left = node("propulsion/left-thrust-fraction")
        self._right = node("propulsion/right-thrust-fraction")
        self._arm = node("propulsion/lateral-arm-ft")
        self._yaw_damper = node("fcs/yaw-damper-on")

    def set_turbulence(self, level: Turbulence) -> None:
        """Switch Dryden turbulence to a level."""
        wind, severity = DRYDEN.get(level, (0.0, 0))
        self._turbulence.set_double_value(_NO_TURBULENCE if level == "none" else _MILSPEC_TURBULENCE)
        self._wind_at_20ft.set_double_value(wind / FT)
        self._severity.set_double_value(severity)

    def set_gust(self, north: float, east: float, down: float, upright: bool = False) -> None:
        """Set the gust, added to the wind [m/s]; ``upright``: it changes the size of lift, not its direction."""
        for node, value in zip(self._gust, (north, east, down), strict=True):
            node.set_double_value(value / FT)
        self._upright.set_double_value(float(upright))

    def set_cg_shift(self, aft: float) -> None:
        """Move the centre of gravity aft of nominal [m]; negative moves it forward."""
        self._ballast.set_double_value(aft / BALLAST / INCH)

    def set_icing(self, drag: float, alpha_max: float = NO_ALPHA_LIMIT) -> None:
        """Set the added drag coefficient [-] and the angle of attack above which lift is lost [rad]."""
        self._drag.set_double_value(drag)
        self._alpha_max.set_double_value(alpha_max)

    def set_thrust(self, left: float, right: float, arm: float = ENGINE_ARM) -> None:
        """Set what is left of each engine's thrust [-] and the engines' lateral arm [m]."""
        self._left.set_double_value(left)
        self._right.set_double_value(right)
        self._arm.set_double_value(arm / FT)

    def set_yaw_damper(self, on: bool) -> None:
        """Switch the reference's hidden yaw damper."""
        self._yaw_damper.set_double_value(float(on))

    def clear(self) -> None:
        """Return to the nominal aircraft and to calm air (the steady wind is a flight's, not an effect)."""
        self.set_turbulence("none")
        self.set_gust(0.0, 0.0, 0.0)
        self.set_cg_shift(0.0)
        self.set_icing(0.0)
        self.set_thrust(1.0, 1.0)
        self.set_yaw_damper(True)
