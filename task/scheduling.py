"""Gain scheduling of the incremental model: Theta of the healthy aircraft where it flies now.

The model prior is of one trim, and what surfaces, damping and stability do grows with the dynamic pressure: at R1
2.7 times, at R2 0.4 times what the prior says. :mod:`task.rates` knows the angular acceleration over the envelope; its
slopes at this state are the columns of p, q and r; what attitude does to them, by way of the auto-throttle, stays the
prior's. Angle of attack and sideslip keep the prior's coefficients, whose aerodynamic part goes with rho V and whose
gravity with 1/V.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from task.limits import DT
from task.model import DYNAMIC
from task.rates import RATES, RateModel, dynamic_pressure, effect_terms, features
from task.state import ACTION, N_ACTION, N_IDENTIFIED, STATE

STEPS = (0.01, 0.01, 0.01, 0.5, 0.03, 0.005)
"""Half the width over which the slopes in p, q, r, V, alpha and beta are taken [rad/s, m/s, rad]. In alpha, at
``STEPS_AT``, it is what a manoeuvre covers, and goes with 1/qbar as the angle for a load factor does: near the stall,
where the pitching moment's slope changes from one half degree to the next, pitch 4 s ahead is foretold a third better
than with 0.3 deg."""
STEPS_AT = 4077.0
"""qbar of 90 m/s at 2000 m [Pa]."""
LEAST_SPEED = 10.0
"""Below it nothing flies, and nothing is scheduled [m/s]."""

AERODYNAMIC = [STATE.alpha, STATE.beta, *(N_IDENTIFIED + surface for surface in ACTION)]
"""Rows of Theta whose effect on angle of attack and sideslip comes from forces of the air."""
GRAVITY = [STATE.phi, STATE.theta]


class Condition(NamedTuple):
    """Where a model prior was learnt."""

    V: float
    """Speed [m/s]."""
    h: float
    """Altitude [m]."""


def slopes(rates: RateModel, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return d(w')/dx (6, 3) in p, q, r, V, alpha, beta and d(w')/du (3, 3) of the healthy aircraft.

    x: (>= 10,) state; u: (3,) deflections that act [rad]. The yaw damper's washed yaw rate counts as yaw rate.
    """
    around = np.tile(np.asarray(x[:N_IDENTIFIED], float), (2 * len(DYNAMIC), 1))
    steps, rows = np.array(STEPS), np.arange(len(DYNAMIC))
    steps[STATE.alpha] *= STEPS_AT / dynamic_pressure(around[0, STATE.V], around[0, STATE.h])
    around[2 * rows, rows] += steps
    around[2 * rows + 1, rows] -= steps
    p, q, r, V, alpha, beta = around[:, : len(DYNAMIC)].T
    qbar = dynamic_pressure(V, around[:, STATE.h])
    phi = np.stack(features(p, q, r, V, alpha, beta, r - x[STATE.r], qbar), axis=1)
    effects = np.tensordot(np.stack(effect_terms(V, alpha, qbar), axis=1), rates.effect, axes=(1, 1))  # (12, 3, 3)
    w_dot = phi @ rates.drift + np.einsum("njw,j->nw", effects, u)
    in_state = (w_dot[::2] - w_dot[1::2]) / (2.0 * steps[:, None])
    return in_state, effects.mean(axis=0)


def scheduled(
    theta: np.ndarray, learnt_at: Condition, rates: RateModel, x: np.ndarray, u: np.ndarray, dt: float = DT
) -> np.ndarray:
    """Return Theta (13, 10) at state x (>= 10,) with deflections u (3,) [rad] that act.

    theta: (13, 10), learnt in the healthy aircraft at ``learnt_at``.
    """
    local = theta.copy()
    if not x[STATE.V] > LEAST_SPEED:
        return local
    in_state, in_action = slopes(rates, x, u)
    local[: len(DYNAMIC), :RATES] = dt * in_state
    local[range(RATES), range(RATES)] += 1.0
    local[-N_ACTION:, :RATES] = dt * in_action
    for angle in (STATE.alpha, STATE.beta):
        schedule_angle(local[:, angle], angle, learnt_at, x, dt)
    return local


def schedule_angle(column: np.ndarray, angle: int, learnt_at: Condition, x: np.ndarray, dt: float = DT) -> None:
    """Take the column (13,) of Theta of angle of attack or sideslip to the state x (>= 10,), in place."""
    V = x[STATE.V]
    air = dynamic_pressure(V, x[STATE.h]) / V / (dynamic_pressure(learnt_at.V, learnt_at.h) / learnt_at.V)
    column[angle] -= 1.0
    column[AERODYNAMIC] *= air
    column[GRAVITY] *= learnt_at.V / V
    column[angle] += 1.0
    if angle == STATE.beta:
        column[STATE.p] = dt * x[STATE.alpha]
