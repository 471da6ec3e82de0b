"""Recorded inputs and outputs of the reference model, and the quantities computed from them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from sim_bridge.aircraft.coefficients import Body, YawDamper
from sim_bridge.aircraft.variables import ALTITUDE_REFERENCE, MACH_REFERENCE, SEA_LEVEL_PRESSURE
from task.errors import UserError
from task.state import ACTION, STATE

FOLDER = Path(__file__).parent / "recordings"
"""Where the recordings lie: ``<case>/<manoeuvre>.npz``."""

GRAVITY = 9.80665
"""Acceleration of gravity [m/s2], at every altitude."""
GAS_CONSTANT = 287.05287
"""Of dry air [J/(kg K)]."""
_LAPSE = 0.0065
_SEA_LEVEL_TEMPERATURE = 288.15
_GEOPOTENTIAL_RADIUS = 6356766.0

ELEVATOR_LIMITS = (float(np.deg2rad(-20.0)), float(np.deg2rad(15.0)))
"""Stops of the reference's elevator [rad]."""


class Recording(NamedTuple):
    """One flight of the reference at 100 Hz."""

    case: str
    """Flight condition or fault."""
    manoeuvre: str
    dt: float
    """Sample time [s]."""
    x: np.ndarray
    """States (N, 12) in the order of STATE."""
    u: np.ndarray
    """Absolute deflections (N, 3) [rad]; row k acts from sample k to sample k + 1."""
    n1: np.ndarray
    """Fan speed (N,) [%]."""
    n2: np.ndarray
    """Core speed (N,) [%]."""

    @property
    def name(self) -> str:
        """Case and manoeuvre in one word."""
        return f"{self.case}/{self.manoeuvre}"


def load(case: str, manoeuvre: str, folder: Path = FOLDER) -> Recording:
    """Read one recording; raise UserError when it is not there."""
    path = folder / case / f"{manoeuvre}.npz"
    try:
        with np.load(path) as file:
            x, u, engine, dt = file["x"], file["u"], file["eng"], float(file["dt"])
    except (OSError, KeyError, ValueError) as error:
        raise UserError(f"{path}: not a recording (arrays x, u, eng, dt expected): {error}") from None
    return Recording(case, manoeuvre, dt, x, u, engine[:, 0], engine[:, 1])


def load_case(case: str, folder: Path = FOLDER) -> list[Recording]:
    """Read every recording of a case, in alphabetical order; raise UserError when there is none."""
    names = sorted(path.stem for path in (folder / case).glob("*.npz"))
    if not names:
        raise UserError(f"{folder / case}: no recordings (*.npz) there; give the folder that holds the cases")
    return [load(case, name, folder) for name in names]


class Air(NamedTuple):
    """The standard atmosphere at some altitudes, arrays of one shape."""

    pressure: np.ndarray
    """[Pa]"""
    density: np.ndarray
    """[kg/m3]"""
    temperature_ratio: np.ndarray
    """Temperature over that at sea level [-]."""
    speed_of_sound: np.ndarray
    """[m/s]"""


def standard_atmosphere(altitude: np.ndarray) -> Air:
    """Return the 1976 standard atmosphere below 11 km for geometric altitudes [m], as JSBSim has it."""
    geopotential = altitude * _GEOPOTENTIAL_RADIUS / (_GEOPOTENTIAL_RADIUS + altitude)
    ratio = 1.0 - _LAPSE * geopotential / _SEA_LEVEL_TEMPERATURE
    temperature = ratio * _SEA_LEVEL_TEMPERATURE
    pressure = SEA_LEVEL_PRESSURE * ratio ** (GRAVITY / (GAS_CONSTANT * _LAPSE))
    return Air(
        pressure,
        pressure / (GAS_CONSTANT * temperature),
        ratio,
        np.sqrt(1.4 * GAS_CONSTANT * temperature),
    )


def washout(r: np.ndarray, damper: YawDamper, dt: float) -> np.ndarray:
    """Return the yaw damper's low-passed yaw rate (N,) [rad/s] for yaw rates r (N,) that start from rest."""
    keep = np.exp(-dt / damper.washout)
    low = np.empty_like(r)
    state = 0.0
    for k, value in enumerate(r):
        low[k] = state
        state = keep * state + (1.0 - keep) * value
    return low


def body_velocity(x: np.ndarray) -> np.ndarray:
    """Return u, v, w [m/s], shape (N, 3), of states (N, 12)."""
    V, alpha, beta = x[:, STATE.V], x[:, STATE.alpha], x[:, STATE.beta]
    return np.stack([V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)], axis=1)


def quantities(
    x: np.ndarray, action: np.ndarray, n1: np.ndarray, low_pass: np.ndarray, body: Body, damper: YawDamper
) -> dict[str, np.ndarray]:
    """Return the variables of :mod:`sim_bridge.aircraft.variables`, and q_bar [Pa], at states (N, 12), in still air.

    action: (N, 3) [rad]; n1: (N,) [%]; low_pass: (N,) from :func:`washout`.
    """
    air = standard_atmosphere(x[:, STATE.h])
    V = x[:, STATE.V]
    q_bar = 0.5 * air.density * V**2
    r = x[:, STATE.r]
    mach = V / air.speed_of_sound
    return {
        "q_bar": q_bar,
        "alpha": x[:, STATE.alpha],
        "beta": x[:, STATE.beta],
        "mach": mach,
        "p_hat": x[:, STATE.p] * body.span / (2.0 * V),
        "q_hat": x[:, STATE.q] * body.chord / V,
        "r_hat": r * body.span / (2.0 * V),
        "elevator": np.clip(action[:, ACTION.de], *ELEVATOR_LIMITS),
        "aileron": action[:, ACTION.da],
        "rudder": action[:, ACTION.dr] + damper.gain * (r - low_pass),
        "mach_offset": mach - MACH_REFERENCE,
        "altitude_offset": (x[:, STATE.h] - ALTITUDE_REFERENCE) / 1e4,
        "n1_corrected": n1 / np.sqrt(air.temperature_ratio),
        "pressure_per_dynamic_pressure": air.pressure / q_bar,
    }
