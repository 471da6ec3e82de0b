"""Tracking reward, crash penalty, termination and safety cost (thesis eqs 12-14)."""

from __future__ import annotations

import numpy as np

from task.limits import DT
from task.state import STATE

REWARD_SCALE = 6.0 / np.pi * np.array([1.0, 1.0, 4.0])
"""c_r of eq. 12 [1/rad] for the errors in theta, phi, beta."""

CRASH_COST_PER_FRAME = 2.0
"""C_P of eq. 13. The text prints 20 with its own scaling; the published runs used 2 for each frame lost."""

THETA_LIMIT = float(np.deg2rad(60.0))
PHI_LIMIT = float(np.deg2rad(75.0))
ALTITUDE_LIMIT = 50.0
"""Beyond |theta|, |phi| [rad] or below this altitude [m] the flight counts as lost."""

UNSAFE_ALPHA = float(np.deg2rad(11.0))
UNSAFE_PHI = float(np.deg2rad(60.0))
"""Bounds of eq. 14 [rad]; beyond either a transition enters the critical buffer."""


def tracking_reward(error: np.ndarray) -> np.ndarray:
    """Return r = -1/3 ||clip(c_r * e, -1, 1)||_1 (eq. 12) for errors (..., 3) [rad], shape (...).

    The text prints the clip as [-1, 0], which would leave positive errors free; the published
    runs clipped symmetrically, and so do we.
    """
    return -np.abs(np.clip(REWARD_SCALE * error, -1.0, 1.0)).sum(axis=-1) / 3.0


def crash_penalty(time_left: np.ndarray | float, dt: float = DT) -> np.ndarray | float:
    """Return r_T = -C_P / dt * (T_max - T) (eq. 13) for the time left [s] when a flight is lost."""
    return -CRASH_COST_PER_FRAME / dt * time_left


def terminated(x: np.ndarray) -> np.ndarray:
    """Return where the flight is lost: attitude or altitude out of bounds, or not finite.

    x: (..., >=10) aircraft state; result (...) bool.
    """
    inside = (
        (np.abs(x[..., STATE.theta]) <= THETA_LIMIT)
        & (np.abs(x[..., STATE.phi]) <= PHI_LIMIT)
        & (x[..., STATE.h] >= ALTITUDE_LIMIT)
        & np.isfinite(x).all(axis=-1)
    )
    return ~inside


def unsafe(x: np.ndarray) -> np.ndarray:
    """Return where a state costs safety: alpha >= 11 deg or |phi| >= 60 deg (eq. 14).

    Eq. 14 prints phi without the modulus; a steep bank is no safer to the left.
    """
    return (x[..., STATE.alpha] >= UNSAFE_ALPHA) | (np.abs(x[..., STATE.phi]) >= UNSAFE_PHI)
