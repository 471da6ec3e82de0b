"""The quantities that the aircraft's terms are built from: name, unit, meaning, and how JSBSim computes them.

One table serves the identification (which computes the same quantities from recordings, in
:mod:`sim_bridge.aircraft.regressors`) and the generator of the JSBSim model.
"""

from __future__ import annotations

from typing import NamedTuple

MACH_REFERENCE = 0.33
"""Mach number about which the interactions are taken: the middle of the recorded range."""
ALTITUDE_REFERENCE = 2000.0
"""Altitude about which the engine's interactions are taken [m]."""
FT = 0.3048
"""One foot [m]."""
SEA_LEVEL_PRESSURE = 101325.0
"""Pressure of the standard atmosphere at sea level [Pa]."""


class Variable(NamedTuple):
    """One quantity: where JSBSim has it, or the function that computes it there."""

    unit: str
    meaning: str
    property: str
    """JSBSim property that holds it."""
    function: str = ""
    """Body of the JSBSim function that computes it; empty when JSBSim has the property itself."""
    in_flight_control: bool = False
    """Computed with the engine, in the flight control section, which JSBSim runs before the aerodynamics."""


def _difference(name: str, value: float) -> str:
    return f"<difference><property>{name}</property><value>{value!r}</value></difference>"


VARIABLES: dict[str, Variable] = {
    "alpha": Variable("rad", "angle of attack, wind included", "aero/alpha-rad"),
    "beta": Variable("rad", "sideslip, wind included", "aero/beta-rad"),
    "mach": Variable("-", "Mach number", "velocities/mach"),
    "p_hat": Variable(
        "-",
        "reduced roll rate p b / (2 V)",
        "aero/p-hat",
        "<product><property>aero/bi2vel</property><property>velocities/p-aero-rad_sec</property></product>",
    ),
    "q_hat": Variable(
        "-",
        "reduced pitch rate q c / V",
        "aero/q-hat",
        "<product><value>2</value><property>aero/ci2vel</property><property>velocities/q-aero-rad_sec</property>"
        "</product>",
    ),
    "r_hat": Variable(
        "-",
        "reduced yaw rate r b / (2 V)",
        "aero/r-hat",
        "<product><property>aero/bi2vel</property><property>velocities/r-aero-rad_sec</property></product>",
    ),
    "elevator": Variable("rad", "elevator deflection, positive nose down", "fcs/elevator-rad"),
    "aileron": Variable("rad", "aileron deflection, positive rolls left", "fcs/aileron-rad"),
    "rudder": Variable("rad", "rudder deflection, yaw damper included, positive nose left", "fcs/rudder-rad"),
    "mach_offset": Variable(
        "-",
        f"Mach number less {MACH_REFERENCE}",
        "aero/mach-offset",
        _difference("velocities/mach", MACH_REFERENCE),
        True,
    ),
    "altitude_offset": Variable(
        "10 km",
        f"altitude less {ALTITUDE_REFERENCE:g} m, in units of 10 km",
        "aero/altitude-offset-10km",
        f"<quotient>{_difference('position/h-sl-meters', ALTITUDE_REFERENCE)}<value>10000</value></quotient>",
        True,
    ),
    "n1_corrected": Variable(
        "%",
        "fan speed over the square root of the temperature ratio",
        "propulsion/n1-corrected-pct",
        "<quotient><property>propulsion/n1-pct</property>"
        "<pow><property>atmosphere/theta</property><value>0.5</value></pow></quotient>",
    ),
    "pressure_per_dynamic_pressure": Variable(
        "-",
        "ambient pressure over dynamic pressure: turns a corrected thrust into a force coefficient",
        "aero/pressure-per-qbar",
        "<quotient><property>atmosphere/P-psf</property><property>aero/qbar-psf</property></quotient>",
    ),
    "n2": Variable("%", "core speed", "propulsion/n2-pct"),
    "speed_error": Variable("m/s", "inertial speed less the auto-throttle's set speed", "fcs/speed-error-mps"),
    "set_speed_offset": Variable(
        "60 m/s",
        "set speed less 90 m/s, in units of 60 m/s",
        "fcs/set-speed-offset",
        f"<quotient>{_difference('fcs/set-speed-mps', 90.0)}<value>60</value></quotient>",
        True,
    ),
}
"""Every name that a term may use."""
