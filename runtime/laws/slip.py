"""Rolling by sideslip: what is left of the bank when the aileron is at its end."""

from __future__ import annotations

import math

RETURN = 0.3
"""How fast a bank error is taken back to its bound, over what it is beyond it [1/s]."""
ROLL = 4.0
"""Roll acceleration asked for, over the error of the roll rate [1/s]."""
HELD = math.radians(2.0)
"""More sideslip than this is held against something that lasts [rad]."""
CLOSING, OPENING = 5.0, 2.0
"""Time constants with which the bound on the bank error closes while sideslip is held, and opens again [s]."""


class BankHold:
    """Keeps the bank error within a bound, by sideslip, where the aileron does not.

    Of the roll rates that suffice,

        p_d >= RETURN (error - bound) - turn   unless the aileron can roll further right
        p_d <= RETURN (error + bound) - turn   unless it can roll further left

    the nearest one is asked for, with as little sideslip as it takes:

        beta_d = beta_f + (ROLL (p_d - p) - p_dot_f) / effect

    The bound is there because sideslip costs more than bank that is soon asked for anew; where sideslip must be held
    anyway, against an aileron that stands askew, it closes.
    """

    def __init__(self, limit: float, dt: float) -> None:
        """limit: the bound while no sideslip is held [rad]; dt: sample time [s]."""
        self._limit, self._dt = limit, dt
        self.reset()

    def reset(self) -> None:
        """Start a new flight."""
        self.bound = self._limit

    def sideslip(
        self, error: float, turn: float, p: float, p_dot: float, beta: float, effect: float, right: bool, left: bool
    ) -> float:
        """Return the sideslip that is asked for at this sample [rad].

        error: reference less bank [rad]; turn: what the body's pitch and yaw rates add to phi_dot [rad/s]; p, p_dot,
        beta: roll rate [rad/s], roll acceleration [rad/s2] and sideslip [rad], the last two filtered alike; effect:
        roll acceleration for each rad of sideslip [1/s2], negative; right, left: whether the aileron can roll further
        that way.
        """

        def needed(edge: float) -> float:
            return beta + (ROLL * (RETURN * edge - turn - p) - p_dot) / effect

        most = math.inf if right else needed(error - self.bound)
        least = -math.inf if left else needed(error + self.bound)
        slip = max(min(0.0, most), least)
        if abs(slip) > HELD:
            self.bound -= self.bound * self._dt / CLOSING
        else:
            self.bound += (self._limit - self.bound) * self._dt / OPENING
        return slip
