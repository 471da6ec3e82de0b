"""Which terms the aircraft's coefficients are made of: the model's structure, without its numbers."""

from __future__ import annotations

import numpy as np

from sim_bridge.aircraft.regression import Unknown, unknown


def _radians(*degrees: float | np.ndarray) -> list[float]:
    return [float(value) for value in np.deg2rad(np.concatenate([np.atleast_1d(d) for d in degrees]))]


ALPHA = _radians(-6.0, np.arange(-5.0, 8.1, 0.5), np.arange(8.25, 11.1, 0.25), 12.0)
"""Breakpoints of lift, drag and pitching moment: fine above 8 deg, where the lift curve bends."""
ALPHA_ELEVATOR = _radians(-6.0, np.arange(-5.0, 8.0), np.arange(8.0, 11.1, 0.5), 12.0)
ALPHA_COARSE = _radians(-6, -4, -2, -1, 0, 1, 2, 3, 4, 6, 8, 9, 9.5, 10, 11)
MACH = [0.2, 0.27, 0.3, 0.33, 0.37, 0.42, 0.5]
ELEVATOR = _radians(-20, -17.5, -15, -10, -5, 0, 5, 10, 15)
"""The reference's elevator tables break at multiples of 5 deg."""
BETA = _radians(-12, -8, -6, -4, -2, 0, 2, 4, 6, 8, 12)
RUDDER = _radians(-26, -20, -15, -12, -10, -8, -6, -4, -2, 0, 2, 4, 6, 8, 10, 12, 15, 20, 26)
N1 = [float(n) for n in range(30, 111, 10)]
N1_FINE = [float(n) for n in range(30, 111, 5)]
NO_THRUST_AT_30 = ((0, 0.0, 1.0),)
"""Drag that falls as 1 / Mach squared cannot be told from thrust: net thrust is taken as zero at 30 % fan speed."""
THRUST_SMOOTHNESS = (30.0,)
EXTRAPOLATED = (30.0,)
"""Stiff: few flights reach the ends of these tables, which must go on straight from where they are known."""
BASIC_SMOOTHNESS = (1.0, 10.0)
"""Along alpha, along Mach. All weights were chosen by flying manoeuvres that were left out of the fit."""
PRESSURE = "pressure_per_dynamic_pressure"

LATERAL = ("beta", "p_hat", "r_hat", "aileron", "rudder")


def _lateral() -> list[Unknown]:
    """Return the terms of CY, Cl or Cn: linear in five variables, whose slopes depend on alpha and Mach."""
    terms = [
        unknown("sideslip_table", {"beta": BETA}, zero_at=0.0, smoothness=EXTRAPOLATED),
        unknown("rudder_table", {"rudder": RUDDER}, zero_at=0.0, smoothness=EXTRAPOLATED),
    ]
    terms += [unknown(f"{name}_alpha", {"alpha": ALPHA_COARSE}, (name,)) for name in LATERAL]
    for name in LATERAL:
        terms.append(unknown(f"{name}_mach", factors=(name, "mach_offset")))
        terms.append(unknown(f"{name}_mach_squared", factors=(name, "mach_offset", "mach_offset")))
        terms.append(unknown(f"{name}_mach_alpha", factors=(name, "mach_offset", "alpha")))
    terms.append(unknown("sideslip_cubed", factors=("beta", "beta", "beta")))
    return terms


def aerodynamics() -> dict[str, list[Unknown]]:
    """Return the structure of the six coefficients; terms named ``thrust...`` are the engines'."""
    alpha_mach = {"alpha": ALPHA, "mach": MACH}
    return {
        "CX": [
            unknown("basic", alpha_mach, smoothness=BASIC_SMOOTHNESS),
            unknown("elevator", {"elevator": ELEVATOR}, zero_at=0.0),
            unknown("elevator_mach", factors=("elevator", "mach_offset")),
            unknown("elevator_alpha", {"alpha": ALPHA_COARSE}, ("elevator",)),
            unknown("pitch_rate", factors=("q_hat",)),
            unknown("pitch_rate_alpha", factors=("q_hat", "alpha")),
            unknown("rudder", factors=("rudder",)),
            unknown("rudder_alpha", factors=("rudder", "alpha")),
            unknown("rudder_squared", factors=("rudder", "rudder")),
            unknown("aileron_squared", factors=("aileron", "aileron")),
            unknown("sideslip_squared", factors=("beta", "beta")),
            unknown("sideslip_rudder", factors=("beta", "rudder")),
            unknown(
                "thrust", {"n1_corrected": N1_FINE}, (PRESSURE,), prior=NO_THRUST_AT_30, smoothness=THRUST_SMOOTHNESS
            ),
            unknown(
                "thrust_mach",
                {"n1_corrected": N1},
                (PRESSURE, "mach_offset"),
                prior=NO_THRUST_AT_30,
                smoothness=THRUST_SMOOTHNESS,
            ),
            unknown(
                "thrust_altitude",
                {"n1_corrected": N1},
                (PRESSURE, "altitude_offset"),
                prior=NO_THRUST_AT_30,
                smoothness=THRUST_SMOOTHNESS,
            ),
        ],
        "CY": _lateral(),
        "CZ": [
            unknown("basic", alpha_mach, smoothness=BASIC_SMOOTHNESS),
            unknown("elevator", {"elevator": ELEVATOR}, zero_at=0.0),
            unknown("pitch_rate", factors=("q_hat",)),
            unknown("pitch_rate_mach", factors=("q_hat", "mach_offset")),
            unknown("sideslip_squared", factors=("beta", "beta")),
            unknown("thrust", {"n1_corrected": N1}, (PRESSURE,)),
        ],
        "Cl": _lateral(),
        "Cm": [
            unknown("basic", alpha_mach, smoothness=BASIC_SMOOTHNESS),
            unknown("elevator", {"elevator": ELEVATOR}, zero_at=0.0),
            unknown("elevator_alpha", {"alpha": ALPHA_ELEVATOR}, ("elevator",)),
            unknown("elevator_mach", factors=("elevator", "mach_offset")),
            unknown("pitch_rate", factors=("q_hat",)),
            unknown("pitch_rate_mach", factors=("q_hat", "mach_offset")),
            unknown("pitch_rate_alpha", factors=("q_hat", "alpha")),
            unknown("sideslip_squared", factors=("beta", "beta")),
            unknown("rudder", factors=("rudder",)),
            unknown("rudder_alpha", factors=("rudder", "alpha")),
            unknown("rudder_squared", factors=("rudder", "rudder")),
            unknown("sideslip_rudder", factors=("beta", "rudder")),
            unknown("thrust", {"n1_corrected": N1}, (PRESSURE,)),
        ],
        "Cn": _lateral(),
    }
