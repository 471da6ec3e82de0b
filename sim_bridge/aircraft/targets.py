"""Force and moment coefficients that the recorded motion demands (rigid-body equations over a flat earth)."""

from __future__ import annotations

import numpy as np

from sim_bridge.aircraft.coefficients import Body, YawDamper
from sim_bridge.aircraft.recordings import GRAVITY, Recording, body_velocity, quantities, washout
from task.state import STATE

FORCES = ("CX", "CY", "CZ")
MOMENTS = ("Cl", "Cm", "Cn")

Samples = tuple[dict[str, np.ndarray], dict[str, np.ndarray]]
"""Variables by name, each (N,), and target coefficients by axis, each (N,)."""


def force_samples(recording: Recording, body: Body, damper: YawDamper) -> Samples:
    """Return variables and CX, CY, CZ between samples: midpoint states, differences as derivatives.

    Accurate to second order in dt, as the Adams-Bashforth scheme is that integrates the velocities in flight.
    """
    x, dt = recording.x, recording.dt
    low = washout(x[:, STATE.r], damper, dt)
    middle = 0.5 * (x[1:] + x[:-1])
    velocity = body_velocity(x)
    u, v, w = (0.5 * (velocity[1:] + velocity[:-1])).T
    middle[:, STATE.V] = np.sqrt(u**2 + v**2 + w**2)
    middle[:, STATE.alpha] = np.arctan2(w, u)
    middle[:, STATE.beta] = np.arctan2(v, np.hypot(u, w))
    u_dot, v_dot, w_dot = (np.diff(velocity, axis=0) / dt).T
    p, q, r = middle[:, STATE.p], middle[:, STATE.q], middle[:, STATE.r]
    phi, theta = middle[:, STATE.phi], middle[:, STATE.theta]
    data = quantities(
        middle, recording.u[:-1], 0.5 * (recording.n1[1:] + recording.n1[:-1]), 0.5 * (low[1:] + low[:-1]), body, damper
    )
    to_coefficient = body.mass / (data["q_bar"] * body.wing_area)
    return data, {
        "CX": to_coefficient * (u_dot - r * v + q * w + GRAVITY * np.sin(theta)),
        "CY": to_coefficient * (v_dot - p * w + r * u - GRAVITY * np.sin(phi) * np.cos(theta)),
        "CZ": to_coefficient * (w_dot - q * u + p * v - GRAVITY * np.cos(phi) * np.cos(theta)),
    }


def moment_samples(recording: Recording, body: Body, damper: YawDamper) -> Samples:
    """Return variables and Cl, Cm, Cn at samples: forward differences as derivatives.

    Euler's scheme integrates the body rates in flight. Fitted to the same scheme, it returns the recorded rates.
    """
    x, dt = recording.x, recording.dt
    left = x[:-1]
    low = washout(x[:, STATE.r], damper, dt)[:-1]
    p, q, r = left[:, STATE.p], left[:, STATE.q], left[:, STATE.r]
    p_dot, q_dot, r_dot = (np.diff(x[:, STATE.p : STATE.r + 1], axis=0) / dt).T
    data = quantities(left, recording.u[:-1], recording.n1[:-1], low, body, damper)
    area = data["q_bar"] * body.wing_area
    ixx, iyy, izz, ixz = body.ixx, body.iyy, body.izz, body.ixz
    return data, {
        "Cl": (ixx * p_dot + (izz - iyy) * q * r - ixz * (r_dot + p * q)) / (area * body.span),
        "Cm": (iyy * q_dot + (ixx - izz) * p * r + ixz * (p**2 - r**2)) / (area * body.chord),
        "Cn": (izz * r_dot + (iyy - ixx) * p * q - ixz * (p_dot - q * r)) / (area * body.span),
    }
