"""Whether a state can follow the last one: attitude that jumps by what no rate turns it is garbage, not flight."""

from __future__ import annotations

import math

from task.state import STATE

_ANGLES = (STATE.phi, STATE.theta, STATE.psi, STATE.alpha, STATE.beta)
_ATTITUDE = 3
"""The first three of them are the body's attitude: no gust moves them."""


class Continuity:
    """Compares each state with the one before, usable or not.

    Between two samples an angle changes by what the body rates turn it, give or take ``JUMP``. One that does not may be
    a sensor that steps, angle of attack, sideslip and speed a gust; two of them, attitude among them, or any three, are
    a state that no aircraft is in. A state is compared with the last one even when that was refused, and after a jump
    ``SOUND`` in a row must follow each other: what lasts, such as an attitude that has been aligned anew, costs a few
    samples, and of garbage hardly anything passes.
    """

    JUMP = 0.015
    """Change of an angle in a sample that the rates need not explain [rad]; at 100 Hz 1.5 rad/s."""
    JERK, SURGE = 0.1, 2.0
    """Changes of a body rate and of speed in a sample that stand for themselves [rad/s, m/s]."""
    SOUND = 3
    """So many states in a row must follow each other before they are used again."""
    LONGEST = 0.1
    """Across a longer gap nothing is compared [s]."""
    STEEPEST = 0.3
    """Least cosine of the pitch angle at which bank and heading are told apart."""

    def __init__(self) -> None:
        self._last: list[float] = []
        self._last_usec = 0
        self._doubted = 0
        """So many more states must follow the last one."""

    def broken(self, x: list[float], time_usec: int) -> bool:
        """Return whether the state x (>= 10,), finite, of time ``time_usec`` cannot follow the last one."""
        last, elapsed = self._last, 1e-6 * (time_usec - self._last_usec)
        self._last, self._last_usec = x, time_usec
        if last and 0.0 < elapsed <= self.LONGEST and self._jumps(last, x, elapsed):
            self._doubted = self.SOUND
        elif self._doubted:
            self._doubted -= 1
        return self._doubted > 0

    def _jumps(self, last: list[float], x: list[float], elapsed: float) -> bool:
        """Return whether one state cannot follow another."""
        angles = [
            abs(math.remainder(x[angle] - last[angle], 2.0 * math.pi) - turned * elapsed) > self.JUMP
            for angle, turned in zip(_ANGLES, _turning(last, x), strict=True)
        ]
        if True not in angles:  # nearly always
            return False
        if abs(math.cos(x[STATE.theta])) < self.STEEPEST:
            angles[0] = angles[2] = False
        shaken = any(abs(x[rate] - last[rate]) > self.JERK for rate in (STATE.p, STATE.q, STATE.r))
        jumps = sum(angles) + shaken + (abs(x[STATE.V] - last[STATE.V]) > self.SURGE)
        return jumps > 2 or (jumps > 1 and True in angles[:_ATTITUDE])


def _turning(last: list[float], x: list[float]) -> tuple[float, float, float, float, float]:
    """Return d/dt of phi, theta, psi, alpha, beta [rad/s] as the mean rates of two states turn the body, no force."""
    p, q, r = (0.5 * (last[i] + x[i]) for i in (STATE.p, STATE.q, STATE.r))
    sin_phi, cos_phi = math.sin(last[STATE.phi]), math.cos(last[STATE.phi])
    theta, alpha = last[STATE.theta], last[STATE.alpha]
    steep = q * sin_phi + r * cos_phi
    cos_theta = math.copysign(max(abs(math.cos(theta)), Continuity.STEEPEST), math.cos(theta))
    psi_dot = steep / cos_theta
    return (
        p + psi_dot * math.sin(theta),
        q * cos_phi - r * sin_phi,
        psi_dot,
        q,
        p * math.sin(alpha) - r * math.cos(alpha),
    )
