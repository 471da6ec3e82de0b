"""Whether a state can follow the last one: attitude that jumps by what no rate turns it is garbage, not flight.

Nor is a state that stands still: whoever flies gets on.
"""

from __future__ import annotations

import math

from task.state import STATE

_ANGLES = (STATE.phi, STATE.theta, STATE.psi, STATE.alpha, STATE.beta)
_RATES = (STATE.p, STATE.q, STATE.r)
_ATTITUDE = 3
"""The first three of the angles are the body's attitude: no gust moves them."""


class Continuity:
    """Compares each state with the one before, usable or not.

    Between two samples an angle changes by what the body rates turn it, give or take ``JUMP``. One that does not may be
    a sensor that steps, angle of attack, sideslip and speed a gust; two of them, attitude among them, or any three, are
    a state that no aircraft is in. A state is compared with the last one even when that was refused, and after a jump
    ``SOUND`` in a row must follow each other, after many ``SOUNDEST``: what lasts, such as an attitude that has been
    aligned anew, costs a few samples, and of garbage hardly anything passes. Where all of a state, position included,
    repeats to the last bit ``STILL`` times, its source stands still, however plausible it is.

    Sensors that are noisy all the time say no garbage: a signal jumps where its change is beyond ``USUAL`` times the
    mean of the last ``MEMORY`` samples' too, refused ones included. Beyond ``WIDEST`` times what stands for itself it
    is a jump in any case, or garbage that lasts would be believed.
    """

    JUMP = 0.015
    """Change of an angle in a sample that the rates need not explain [rad]; at 100 Hz 1.5 rad/s."""
    JERK, SURGE = 0.1, 2.0
    """Changes of a body rate and of speed in a sample that stand for themselves [rad/s, m/s]."""
    SOUND, SOUNDEST = 3, 10
    """So many states in a row must follow each other before they are used again: as many as did not, within these."""
    STILL = 2
    """A source of half the rate repeats each state once."""
    USUAL, MEMORY, WIDEST = 4.0, 100, 3.0
    """Times the mean [-]; samples; times what stands for itself [-], which is the most that a change counts for."""
    LONGEST = 0.1
    """Across a longer gap nothing is compared [s]."""
    STEEPEST = 0.3
    """Least cosine of the pitch angle at which bank and heading are told apart."""

    def __init__(self) -> None:
        self._last: list[float] = []
        self._last_usec = 0
        self._doubted = 0
        """So many more states must follow the last one."""
        self._jumps_seen = 0
        """How often there were jumps since states were used last."""
        self._least = [self.JUMP] * len(_ANGLES) + [self.JERK] * len(_RATES) + [self.SURGE]
        self._mean, self._compared = [0.0] * len(self._least), 0
        self._same = 0
        """How often the last state has repeated."""

    def broken(self, x: list[float], time_usec: int) -> bool:
        """Return whether the state x (12,), finite, of time ``time_usec`` cannot follow the last one."""
        self._same = self._same + 1 if x == self._last else 0
        last, elapsed = self._last, 1e-6 * (time_usec - self._last_usec)
        self._last, self._last_usec = x, time_usec
        if last and 0.0 < elapsed <= self.LONGEST and self._jumps(last, x, elapsed):
            self._jumps_seen = self._jumps_seen + 1 if self._doubted else 1
            self._doubted = min(max(self._jumps_seen, self.SOUND), self.SOUNDEST)
        elif self._doubted:
            self._doubted -= 1
        return self._doubted > 0 or self._same >= self.STILL

    def _jumps(self, last: list[float], x: list[float], elapsed: float) -> bool:
        """Return whether one state cannot follow another."""
        changes = [
            abs(math.remainder(x[angle] - last[angle], 2.0 * math.pi) - turned * elapsed)
            for angle, turned in zip(_ANGLES, _turning(last, x), strict=True)
        ]
        changes += [abs(x[signal] - last[signal]) for signal in (*_RATES, STATE.V)]
        self._compared += 1
        share, jumped = 1.0 / min(self._compared, self.MEMORY), []
        for i, (change, least, mean) in enumerate(zip(changes, self._least, self._mean, strict=True)):
            most = self.WIDEST * least
            jumped.append(change > min(max(least, self.USUAL * mean), most))
            self._mean[i] = mean + share * (min(change, most) - mean)
        if True not in jumped:  # nearly always
            return False
        if abs(math.cos(x[STATE.theta])) < self.STEEPEST:
            jumped[0] = jumped[2] = False
        angles, shaken, surged = jumped[: len(_ANGLES)], any(jumped[len(_ANGLES) : -1]), jumped[-1]
        jumps = sum(angles) + shaken + surged
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
