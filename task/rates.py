"""Angular acceleration of the healthy aircraft, with each surface's effect in its own term.

    w' = A phi(x) + qbar * sum_j lambda_j B_j(alpha, V) u_j + b,    w = (p, q, r)

u_j is the absolute deflection of surface j, lambda_j its signed effectiveness (1 when healthy, -1 when reversed) and b
what the model does not know. The plant integrates the rotation by Euler's scheme, and a command is one sample late
(``command_lag``): w[k+1] = w[k] + dt * w'(x[k], u[k - command_lag]).

Everything here takes floats or arrays of one shape.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from task.state import N_ACTION

RATE_MODEL_VERSION = 2
"""Of the structure below; a file of coefficients says for which structure they were fitted."""
RATES = 3
"""p, q, r: the first three states."""

WASHOUT = 4.0
"""Time constant of the yaw rate's washout in the Citation's yaw damper [s]."""

SCALE_HEIGHT = 44330.8
"""Height at which the standard troposphere's temperature would be zero [m]."""
DENSITY_EXPONENT = 4.2559
SEA_LEVEL_DENSITY = 1.225
"""[kg/m3]"""
TROPOPAUSE = 11_000.0
"""The density formula ends here [m]; above it the density at this height is used."""

V_NOMINAL = 90.0
"""Speed about which the terms in speed are written [m/s]."""
KNEE = math.radians(8.0)
"""Angle of attack above which the lift curve bends [rad]."""
BENDS = tuple(math.radians(degrees) for degrees in (4.0, 6.0, 9.0, 9.5, 10.0, 10.5, 11.0))
"""Angles of attack beside the knee at which the pitching moment's slope may change [rad]: close to each other at the
stall, where it does so within half a degree."""
LOW_ALPHA, HIGH_ALPHA = math.radians(-6.0), math.radians(12.0)
"""The fit has seen angles of attack from about here to there [rad]. Beyond them every term stays as it is there:
continued, the bends would have surfaces work backwards in a deep stall."""
N_FEATURES = 26 + len(BENDS)
"""Length of phi."""
SIDESLIP = slice(8, 13)
"""Where among the features those of the sideslip are."""
N_EFFECT = 4
"""Terms of B_j: constant, alpha, speed, knee."""


class RateModel(NamedTuple):
    """The coefficients of the healthy aircraft."""

    drift: np.ndarray
    """A (33, 3): features, then p, q, r [rad/s2 per feature]."""
    effect: np.ndarray
    """B (3, 4, 3): surface j, term of :func:`effect_terms`, axis of p, q, r [rad/s2 per Pa rad]."""


def dynamic_pressure(V: Any, h: Any) -> Any:
    """Return qbar [Pa] at speed V [m/s] and altitude h [m] in the standard troposphere (still air)."""
    low = 0.5 * (h + TROPOPAUSE - abs(h - TROPOPAUSE))  # min(h, TROPOPAUSE), for floats and arrays alike
    return 0.5 * SEA_LEVEL_DENSITY * (1.0 - low / SCALE_HEIGHT) ** DENSITY_EXPONENT * V * V


def features(p: Any, q: Any, r: Any, V: Any, alpha: Any, beta: Any, washed: Any, qbar: Any) -> tuple[Any, ...]:
    """Return phi(x), 33 terms. washed: the high-passed yaw rate [rad/s] that the yaw damper feeds to the rudder."""
    alpha = known(alpha)
    damping = qbar / (V + 1e-9)  # at V = 0 there is neither
    speed = V / V_NOMINAL - 1.0
    one = 0.0 * V + 1.0
    return (
        one,
        qbar,
        qbar * alpha,
        qbar * alpha * alpha,
        qbar * alpha * alpha * alpha,
        qbar * beyond(alpha, KNEE),
        qbar * speed,
        qbar * speed * alpha,
        qbar * beta,
        qbar * beta * beta,
        qbar * beta * beta * beta,
        qbar * alpha * beta,
        qbar * speed * beta,
        damping * p,
        damping * q,
        damping * r,
        damping * alpha * p,
        damping * alpha * q,
        damping * alpha * r,
        damping * speed * p,
        damping * speed * q,
        damping * speed * r,
        qbar * washed,
        p * q,
        q * r,
        p * r,
        *(qbar * beyond(alpha, bend) for bend in BENDS),
    )


def sideslip_slopes(V: Any, alpha: Any, beta: Any, qbar: Any) -> tuple[Any, ...]:
    """Return the derivatives of the features ``SIDESLIP`` by the sideslip [1/rad]; those of all others are zero."""
    return qbar, 2.0 * qbar * beta, 3.0 * qbar * beta * beta, qbar * known(alpha), qbar * (V / V_NOMINAL - 1.0)


def effect_terms(V: Any, alpha: Any, qbar: Any) -> tuple[Any, Any, Any, Any]:
    """Return the terms that B_j is linear in, times qbar."""
    alpha = known(alpha)
    return qbar, qbar * alpha, qbar * (V / V_NOMINAL - 1.0), qbar * beyond(alpha, KNEE)


def known(alpha: Any) -> Any:
    """Return the angle of attack within what the fit has seen [rad]."""
    return LOW_ALPHA + beyond(alpha, LOW_ALPHA) - beyond(alpha, HIGH_ALPHA)


def beyond(angle: Any, bend: float) -> Any:
    """Return by how much an angle is greater than another, or 0 [rad]."""
    over = angle - bend
    return 0.5 * (over + abs(over))  # max(over, 0), for floats and arrays alike


def washout(low_passed: float, r: float, dt: float) -> float:
    """Return the next low-passed yaw rate [rad/s]; the washed one is r minus it."""
    return low_passed + dt / WASHOUT * (r - low_passed)


def shapes() -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of :class:`RateModel`."""
    return {"drift": (N_FEATURES, RATES), "effect": (N_ACTION, N_EFFECT, RATES)}
