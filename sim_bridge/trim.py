"""Where a flight starts inside JSBSim, and the search for a start that is steady."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sim_bridge.air import STILL_AIR, Air
from sim_bridge.conditions import FlightCondition
from task.errors import UserError
from task.state import N_STATE, STATE

ROUNDS = 60
"""Most Newton steps."""
ACCURACY = 1e-9
"""Largest acceleration left in a trim [ft/s2, rad/s2], in JSBSim's units."""
DIFFERENCES = np.array([1e-4, 1e-4, 1e-3])
"""For the slopes: alpha, elevator [rad], speed error [m/s]."""
STRIDE = np.array([0.05, 0.05, 0.2])
"""Longest Newton step in each."""
GUESS = np.array([math.radians(4.0), math.radians(-2.0), -1.2])
"""First alpha, elevator [rad] and speed error [m/s]."""


class Trim(NamedTuple):
    """A steady flight."""

    x: np.ndarray
    """State, shape (12,), in the order of :class:`task.state.STATE`."""
    action: np.ndarray
    """Deflections that hold it [rad], shape (3,)."""
    n1: float
    """Fan speed of the engines [%]."""
    n2: float
    """Core speed of the engines [%]."""


class Start(NamedTuple):
    """Everything that JSBSim must know to begin."""

    x: np.ndarray
    """Inertial state (12,)."""
    action: np.ndarray
    """Deflections before the first step [rad], shape (3,)."""
    set_speed: float
    """Speed through the steady wind that the auto-throttle holds [m/s]."""
    n1: float
    """[%]"""
    n2: float
    """[%]"""
    washout: float = 0.0
    """The yaw damper's low-passed yaw rate [rad/s]."""
    air: Air = STILL_AIR


class Response(NamedTuple):
    """What JSBSim makes of a start."""

    accelerations: np.ndarray
    """Of u, w [ft/s2] and q [rad/s2], shape (3,)."""
    n1_command: float
    """Fan speed that the auto-throttle asks for [%]."""
    n2_command: float
    """[%]"""


def find_trim(condition: FlightCondition, respond: Callable[[Start], Response]) -> Trim:
    """Return the steady flight of a condition in still air: Newton's method on alpha, elevator and throttle.

    The throttle is found as the speed error at which the auto-throttle would ask for it; as in the reference, a
    flight then starts at the set speed itself, from those engine speeds. Raises UserError when there is none.
    """
    x = np.zeros(N_STATE)
    x[STATE.V], x[STATE.h], x[STATE.psi] = condition.speed, condition.altitude, condition.heading
    spools = (50.0, 60.0)

    def residual(z: np.ndarray) -> np.ndarray:
        nonlocal spools
        alpha, elevator, speed_error = z.tolist()
        x[STATE.alpha], x[STATE.theta] = alpha, alpha + condition.flight_path
        start = Start(x, np.array([elevator, 0.0, 0.0]), condition.speed - speed_error, *spools)
        asked = respond(start)
        spools = (asked.n1_command, asked.n2_command)
        return respond(start._replace(n1=spools[0], n2=spools[1])).accelerations

    unknowns = GUESS
    for _ in range(ROUNDS):
        left = residual(unknowns)
        if np.abs(left).max() < ACCURACY:
            return Trim(x.copy(), np.array([unknowns[1], 0.0, 0.0]), *spools)
        slopes = [(residual(unknowns + step) - left) / step.max() for step in np.diag(DIFFERENCES)]
        change, *_ = np.linalg.lstsq(np.stack(slopes, axis=1), -left, rcond=None)
        unknowns = unknowns + change / max(1.0, float(np.abs(change / STRIDE).max()))
        if not np.isfinite(unknowns).all():
            break
    raise UserError(
        f"flight condition altitude {condition.altitude:g} m, speed {condition.speed:g} m/s, flight path "
        f"{math.degrees(condition.flight_path):g} deg: the aircraft cannot be trimmed there; "
        "stay near the conditions it was identified at: 2000 m and 90 to 150 m/s, 10000 m and 90 m/s"
    )


def carried_by_wind(x: np.ndarray, air: Air) -> np.ndarray:
    """Return the inertial state (12,) of an aircraft that flies x through the steady wind of ``air``."""
    if air.wind_north == 0.0 and air.wind_east == 0.0:
        return x
    V, alpha, beta = x[STATE.V], x[STATE.alpha], x[STATE.beta]
    through_air = V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    u, v, w = through_air + body_from_ned(x) @ np.array([air.wind_north, air.wind_east, 0.0])
    moved = x.copy()
    moved[STATE.V] = math.sqrt(u * u + v * v + w * w)
    moved[STATE.alpha] = math.atan2(w, u)
    moved[STATE.beta] = math.atan2(v, math.hypot(u, w))
    return moved


def body_from_ned(x: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) that takes north-east-down components to body components."""
    sin_phi, cos_phi = np.sin(x[STATE.phi]), np.cos(x[STATE.phi])
    sin_theta, cos_theta = np.sin(x[STATE.theta]), np.cos(x[STATE.theta])
    sin_psi, cos_psi = np.sin(x[STATE.psi]), np.cos(x[STATE.psi])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cos_phi, sin_phi], [0.0, -sin_phi, cos_phi]])
    pitch = np.array([[cos_theta, 0.0, -sin_theta], [0.0, 1.0, 0.0], [sin_theta, 0.0, cos_theta]])
    yaw = np.array([[cos_psi, sin_psi, 0.0], [-sin_psi, cos_psi, 0.0], [0.0, 0.0, 1.0]])
    return roll @ pitch @ yaw
