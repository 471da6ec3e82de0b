"""The incremental model of the aircraft and its exact attitude kinematics (thesis eq. 8.2).

One parameter matrix Theta = [F'; G'] (eq. 8.4), shape (13, 10), maps z = [dx; da] to the next state
increment, dx[t+1] = Theta' z. With ``exact_kinematics`` the four increments of phi, theta, psi and h
come from the kinematic equations instead, and Theta has zero rows for psi and h: the reduced model
of six dynamic states is the same matrix with fewer unknowns, so one predictor serves both.

``command_lag`` is the number of samples between a command and the first state increment that it
moves, beyond the one of eq. 8.2: a[t] acts in dx[t+1+command_lag]. It is 1 for a plant that
propagates before it reads its commands (docs/interface.md).
"""

from __future__ import annotations

import numpy as np

from task.limits import DT
from task.state import N_ACTION, N_IDENTIFIED, STATE

N_REGRESSORS = N_IDENTIFIED + N_ACTION

DYNAMIC = tuple(range(STATE.p, STATE.beta + 1))
"""p, q, r, V, alpha, beta: the states whose increments the reduced model predicts."""
REDUCED_REGRESSORS = (*DYNAMIC, int(STATE.phi), int(STATE.theta), *range(N_IDENTIFIED, N_REGRESSORS))
"""Rows of the full z that the reduced model uses: six states, phi, theta and three commands."""


def kinematic_rates(x: np.ndarray) -> np.ndarray:
    """Return d/dt of phi, theta, psi [rad/s] and h [m/s], shape (..., 4), for states (..., >=10)."""
    # Of a single state, numbers: what numpy makes of x[..., i] is an array without axes, and three times as slow.
    p, q, r, V, alpha, beta, phi, theta = np.moveaxis(x[..., : STATE.psi], -1, 0) if x.ndim > 1 else x[: STATE.psi]
    sin_phi, cos_phi, sin_theta, cos_theta = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    sin_alpha, cos_alpha, sin_beta, cos_beta = np.sin(alpha), np.cos(alpha), np.sin(beta), np.cos(beta)
    yawing = (q * sin_phi + r * cos_phi) / cos_theta
    climb = (
        cos_alpha * cos_beta * sin_theta - sin_beta * sin_phi * cos_theta - sin_alpha * cos_beta * cos_phi * cos_theta
    )
    rates = np.empty((*x.shape[:-1], 4), x.dtype)
    rates[..., 0] = p + yawing * sin_theta
    rates[..., 1] = q * cos_phi - r * sin_phi
    rates[..., 2] = yawing
    rates[..., 3] = V * climb
    return rates


def predict_increment(
    x: np.ndarray, dx: np.ndarray, da: np.ndarray, theta: np.ndarray, exact_kinematics: bool, dt: float = DT
) -> np.ndarray:
    """Return the next increment dx[t+1], shape (..., 10) (eq. 8.2).

    x: (..., 10) state; dx: (..., 10) last increment; da: (..., 3) increment of the command that acts
    now; theta: (13, 10) or (..., 13, 10). With exact kinematics, phi, theta, psi and h follow from the
    mean of the old and the predicted body rates at the old attitude.
    """
    z = np.concatenate([dx, da], axis=-1)
    nxt = np.matmul(z[..., None, :], theta)[..., 0, :]
    if exact_kinematics:
        mid = x.copy()
        mid[..., : STATE.beta + 1] += 0.5 * nxt[..., : STATE.beta + 1]
        nxt[..., STATE.phi : STATE.h + 1] = dt * kinematic_rates(mid)
    return nxt


def with_effectiveness(theta: np.ndarray, effectiveness: np.ndarray) -> np.ndarray:
    """Return the model (..., 13, 10) of an aircraft whose surfaces deflect by Lambda times the command.

    theta: (..., 13, 10), of healthy surfaces; effectiveness: Lambda (..., 3, 3), row: the surface that moves, column:
    the command that moves it. Signed, weak and dead surfaces are its diagonal, crossed ones lie beside it. From
    dx = F' dx + G' (Lambda da) follows G <- Lambda' G.
    """
    changed = np.broadcast_to(theta, np.broadcast_shapes(theta.shape[:-2], effectiveness.shape[:-2]) + theta.shape[-2:])
    changed = changed.copy()
    changed[..., N_IDENTIFIED:, :] = np.matmul(np.swapaxes(effectiveness, -1, -2), changed[..., N_IDENTIFIED:, :])
    return changed


def embed_reduced(theta_reduced: np.ndarray) -> np.ndarray:
    """Return the (13, 10) matrix of a reduced model (11, 6); unused rows and columns are zero."""
    full = np.zeros((N_REGRESSORS, N_IDENTIFIED), dtype=theta_reduced.dtype)
    full[np.ix_(REDUCED_REGRESSORS, DYNAMIC)] = theta_reduced
    return full
