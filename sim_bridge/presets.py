"""The thesis's cases (table 2) as settings of the general mechanisms."""

from __future__ import annotations

import math

from sim_bridge.faults import AnyFault, CGShift, Effectiveness, Gust, Icing, Jam, Saturation
from sim_bridge.sensors import SensorSettings

F1: tuple[AnyFault, ...] = (Icing(),)
"""Iced wings: drag +0.05 (as recorded; the thesis prints 0.06), lift frozen above 7.7 degrees."""
F2: tuple[AnyFault, ...] = (CGShift(aft=0.25),)
"""Centre of gravity 0.25 m aft."""
F3: tuple[AnyFault, ...] = (Saturation(surface="aileron", min_deg=-1.0, max_deg=1.0),)
"""Aileron clipped at +-1 degree."""
F4: tuple[AnyFault, ...] = (Saturation(surface="elevator", min_deg=-2.5, max_deg=2.5),)
"""Elevator clipped at +-2.5 degrees."""
F5: tuple[AnyFault, ...] = (Effectiveness(surface="elevator", factor=0.3),)
"""Elevator effectiveness x 0.3, trim deflection included."""
F6: tuple[AnyFault, ...] = (Jam(surface="rudder", angle_deg=15.0),)
"""Rudder jammed at 15 degrees; the yaw damper keeps working."""
R3_GUST: tuple[AnyFault, ...] = (Gust(start=20.0, end=23.0, down=15.0 * 0.3048, as_reference=True),)
"""Gust of 15 ft/s from 20 to 23 s. The thesis calls it upward; the reference's recording shows air that sinks."""
R3_SENSORS = SensorSettings(
    noise={
        "p": math.sqrt(4e-7),
        "q": math.sqrt(4e-7),
        "r": math.sqrt(4e-7),
        "theta": math.sqrt(1e-9),
        "phi": math.sqrt(1e-9),
        "alpha": math.sqrt(4e-10),
    },
    bias={"p": 3e-5, "q": 3e-5, "r": 3e-5, "theta": 4e-3, "phi": 4e-3},
)
"""Sensors of R3 (table 3), whose noise magnitudes are variances: 6.3e-4 rad/s on the rates, 3.2e-5 rad on attitude."""

CASES: dict[str, tuple[AnyFault, ...]] = {"F1": F1, "F2": F2, "F3": F3, "F4": F4, "F5": F5, "F6": F6, "R3": R3_GUST}
"""By the thesis's name; R1 and R2 are flight conditions (sim_bridge.conditions)."""
