"""Rolling by sideslip: what is left of the bank when the aileron is at its end."""

from __future__ import annotations

import math

RETURN, BRAKE = 0.3, 4.0
"""How fast a bank error may come back to its bound, and move towards it, over how far from it it is [1/s]. Within,
sideslip is kept for what would leave in a quarter of a second: an aileron at its end for a moment is mostly at work."""
ROLL = 4.0
"""Roll acceleration asked for, over the error of the roll rate [1/s]."""
HELD = math.radians(4.0)
"""More sideslip than this is held against something that lasts [rad]."""
CLOSING, OPENING = 5.0, 10.0
"""Time constants with which the bound on the bank error closes while so much is held, and opens again [s]."""
OPEN = 0.9
"""A bound that is smaller than so much of what it is made with has not opened yet [-]."""


class BankHold:
    """Keeps the bank error within a bound, by sideslip, where the aileron does not.

    Of the roll rates that suffice,

        p_d >= k (error - bound) - turn   unless the aileron can roll further right
        p_d <= k (error + bound) - turn   unless it can roll further left

    k being RETURN beyond the bound and BRAKE within, the nearest one is asked for, with as little sideslip as it takes:

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

    @property
    def closed(self) -> bool:
        """Return whether sideslip was held lately: what then holds the bank must not go at once."""
        return self.bound < OPEN * self._limit

    def sideslip(
        self, error: float, turn: float, p: float, p_dot: float, beta: float, effect: float, right: bool, left: bool
    ) -> float:
        """Return the sideslip that is asked for at this sample [rad].

        error: reference less bank [rad]; turn: what the body's pitch and yaw rates add to phi_dot [rad/s]; p, p_dot,
        beta: roll rate [rad/s], roll acceleration [rad/s2] and sideslip [rad], the last two filtered alike; effect:
        roll acceleration for each rad of sideslip [1/s2], negative; right, left: whether the aileron can roll further
        that way.
        """

        def needed(beyond: float, side: float) -> float:
            rate = side * (RETURN if beyond > 0.0 else BRAKE) * beyond
            return beta + (ROLL * (rate - turn - p) - p_dot) / effect

        most = math.inf if right else needed(error - self.bound, 1.0)
        least = -math.inf if left else needed(-error - self.bound, -1.0)
        slip = max(min(0.0, most), least)
        if abs(slip) > HELD:
            self.bound -= self.bound * self._dt / CLOSING
        else:
            self.bound += (self._limit - self.bound) * self._dt / OPENING
        return slip
