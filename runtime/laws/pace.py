"""How high an INDI's gains may be while its surfaces answer late: commands under way, or surfaces that move slowly."""

from __future__ import annotations

import math
from collections.abc import Sequence

from runtime.laws.law import Row


class Pace:
    """The gains of both loops, no higher than the delay of the surfaces lets them.

    Surfaces whose rate is limited come late by what the one that is furthest from where it is asked to be needs for
    half of its way, at its longest lately. In gentle flight that is hardly anything, and the gains are those of healthy
    surfaces.
    """

    REACH = 0.5
    """Largest gain of a rate loop times the delay [-]; an ideal loop would be lost at pi / 2."""
    CASCADE = 0.4
    """Largest gain of an attitude loop over that of its rate loop, while anything is late [-]."""
    WAY = 0.034
    """The longest way that counts, and the one as long as none has been seen [rad]: with gains that fell further the
    aircraft would be left to itself."""
    WAY_TIME = 3.0
    """Time constant with which a way is forgotten [s]."""

    def __init__(self, attitude: Row, rate: Row, dt: float) -> None:
        """Gains of healthy surfaces [1/s]: of theta, phi and beta, and of p, q and r."""
        self._attitude, self._rate = attitude, rate
        self._dt, self._kept = dt, 1.0 - dt / self.WAY_TIME
        self.reset()

    def reset(self) -> None:
        """Start a new flight: nothing is late."""
        self.match(0, math.inf)

    def match(self, delay: int, fastest: float) -> None:
        """Take how late commands act [samples], and how fast surfaces move at most [rad/s]."""
        self._delay, self._fastest, self._way = delay * self._dt, fastest, self.WAY
        self._choose()

    def follow(self, asked: Sequence[float], acts: Sequence[float]) -> None:
        """Take where the surfaces are asked to be and where they are (3,) [rad], each sample."""
        if self._fastest < math.inf:
            way = max(abs(to - at) for to, at in zip(asked, acts, strict=True))
            self._way = min(max(way, self._kept * self._way), self.WAY)
            self._choose()

    def _choose(self) -> None:
        late = self._delay + 0.5 * self._way / self._fastest
        self.rate, self.attitude = self._rate, self._attitude
        """Gains [1/s] of the loops of p, q, r, and of those of pitch, bank and sideslip."""
        if late:
            most = self.REACH / late
            k_p, k_q, k_r = (min(k, most) for k in self._rate)
            k_theta, k_phi, k_beta = self._attitude
            c = self.CASCADE
            self.rate = k_p, k_q, k_r
            self.attitude = min(k_theta, c * k_q), min(k_phi, c * k_p), min(k_beta, c * k_r)
