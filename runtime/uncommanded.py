"""Surfaces that move besides by themselves: one filter for each surface finds what it adds to its commands.

The surface does what it did before the filters opened, and moves by d besides, as when its servo oscillates:

    lambda_before B (u + d),    d+ = d + dt d',    d'+ = d' + white noise

Such a filter's place of that surface's lambda holds d, its second slope's place d'. Without, what swings is taken for
a surface that is late, slow or weak, and for each of them in turn.
"""

from __future__ import annotations

import math

import numpy as np

from runtime.rate_filter import LAMBDA, MOTION, SLOPES, Motion, RateFilters
from task.state import N_ACTION

UNIT = 0.1
"""Deflection that one stands for in the place of lambda [rad]."""
SURFACES = np.arange(N_ACTION)
PLACES = LAMBDA.start + SURFACES
SLOPE = SLOPES.start
"""The place of dq'/d(alpha); the other slope's is taken."""


class Uncommanded:
    """What the three filters are told of the deflections, and how well each surface is taken to work."""

    FAR, FAST = 0.1, 1.0
    """Standard deviations of d [rad] and d' [rad/s] when the filters open."""

    ODDS = 10.0
    """How far behind such a hypothesis starts when the filters open [nats]: what moves freely explains much."""
    ROUGH = 20.0
    """Turbulence's level on the surface's axis from which on it is not heard [-]."""
    FARTHEST = 0.12
    """No surface moves farther by itself [rad]; what seems to does something else, such as to work backwards."""
    LASTS = 2.0
    """Time constant of what in d lasts [s], which may as well be the bias."""

    def __init__(self, filters: RateFilters, first: int, agile: int, dt: float) -> None:
        """``first``: row of the elevator's filter; aileron's and rudder's follow; ``agile``: of the first agile one."""
        self._filters, self._gain = filters, dt / self.LASTS
        self.effectiveness = np.ones(N_ACTION)
        """lambda (3,), taken to hold."""
        self._mean, self._away = np.zeros((2, N_ACTION))
        """The part of d that lasts, and what d is beyond it [UNIT]."""
        self._rows = first + SURFACES
        own = filters.motion(slice(first, first + N_ACTION), LAMBDA)
        self._place, self._speed = own.place, own.speed
        """d and d' (3,), in the filters [UNIT]."""
        followers = slice(agile, agile + N_ACTION)
        self._moving: dict[int | None, tuple[Motion, ...]] = {None: (own,)}
        """What moves by itself, by the surface that is believed to."""
        for surface, place in enumerate(PLACES.tolist()):
            self._moving[surface] = own, filters.motion(followers, place)

    def learn(self) -> None:
        """Take what the filters have made of the measurement."""
        np.subtract(self._place, self._mean, out=self._away)
        self._mean += self._gain * self._away

    def hear(self, told: list[float], believed: int | None, levels: list[float] | None) -> None:
        """Silence, in the log-likelihoods of all hypotheses, who has no say.

        That a surface moves by itself is heard while the filters are open, and not in rough air: gusts move so too.
        believed: the surface that is believed to; levels (3,): of turbulence on each surface's axis, None where closed.
        """
        for surface, row in enumerate(self._rows.tolist()):
            if surface != believed and (levels is None or levels[surface] >= self.ROUGH):
                told[row] = -math.inf

    def refuted(self, believed: int | None) -> bool:
        """Return whether the surface that is believed to move by itself, if any, would move too far."""
        return believed is not None and UNIT * abs(self._away.item(believed)) > self.FARTHEST

    def rest(self, effectiveness: np.ndarray) -> None:
        """Take lambda (3,) to hold from now on, and no surface to move by itself."""
        self.effectiveness[:] = effectiveness
        self._place[:] = self._speed[:] = 0.0
        self._mean[:] = self._away[:] = 0.0

    def open(self, effectiveness: np.ndarray) -> None:
        """Look anew for how each surface moves; effectiveness (3,): as settled before."""
        self.rest(effectiveness)
        self._filters.variances[self._rows, PLACES] = (self.FAR / UNIT) ** 2
        self._filters.variances[self._rows, MOTION] = (self.FAST / UNIT) ** 2
        # Beside d a free slope is known by next to nothing, and wanders: what then pitches with the angle of attack is
        # taken for motion, and refutes it.
        self._filters.variances[self._rows, SLOPE] = 0.0

    def deflect(self, u: np.ndarray, coefficient: np.ndarray, known: np.ndarray, believed: int | None) -> None:
        """Set what the filters multiply lambda with, what they know of the deflections, and which of them move.

        u (3,): the commands that act [rad]; coefficient, known (3, 3): rows are filters, columns surfaces; believed:
        the surface that is believed to move by itself, or None.
        """
        coefficient[SURFACES, SURFACES] = UNIT * self.effectiveness
        known[SURFACES, SURFACES] = self.effectiveness * u
        self._filters.moving = self._moving[believed]
