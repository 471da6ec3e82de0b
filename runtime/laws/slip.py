"""Rolling by sideslip: what is left of the bank when the aileron is at its end."""

from __future__ import annotations

import math

RETURN = 0.3
"""How fast a bank error is taken back to its bound, over what it is beyond it [1/s]."""
ROLL = 4.0
"""Roll acceleration asked for, over the error of the roll rate [1/s]."""


def rolling_sideslip(
    error: float, bound: float, turn: float, p: float, p_dot: float, beta: float, effect: float, right: bool, left: bool
) -> float:
    """Return the sideslip [rad] that keeps the bank error within its bound where the aileron does not; else 0.

    error, bound: reference less bank, and what of it is left alone [rad]; turn: what the body's pitch and yaw rates add
    to phi_dot [rad/s]; p, p_dot, beta: roll rate [rad/s], roll acceleration [rad/s2] and sideslip [rad], the last two
    filtered alike; effect: roll acceleration for each rad of sideslip [1/s2], negative; right, left: whether the
    aileron can roll further that way. Of the roll rates that suffice,

        p_d >= RETURN (error - bound) - turn   unless the aileron can roll further right
        p_d <= RETURN (error + bound) - turn   unless it can roll further left

    the nearest one is asked for, with as little sideslip as it takes:

        beta_d = beta_f + (ROLL (p_d - p) - p_dot_f) / effect
    """

    def needed(edge: float) -> float:
        return beta + (ROLL * (RETURN * edge - turn - p) - p_dot) / effect

    most = math.inf if right else needed(error - bound)
    least = -math.inf if left else needed(error + bound)
    return max(min(0.0, most), least)
