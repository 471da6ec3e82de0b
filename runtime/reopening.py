"""The filters begin anew: at the start of a flight, after an alarm, and where what was learnt has to be undone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from runtime.config import Adaptation
from runtime.hypotheses import Evidence
from runtime.opening import Opening, Recollection
from runtime.process_noise import ProcessNoise
from runtime.ranges import Ranges
from runtime.rate_filter import LAMBDA, SLOPES, B, RateFilters, W
from runtime.uncommanded import Uncommanded
from task.rates import RATES
from task.state import N_ACTION

AXIS = (1, 0, 2)
"""Which of p, q, r elevator, aileron and rudder move most."""


class Reopening:
    """Opens the filters after an alarm and closes them again, and says how sure they are of what when they begin.

    ``opening`` counts the time since the alarm, ``past`` is what was known before it.
    """

    STEADY = 0.1
    """Of the doubt about the bias when the filters open, where only a range is looked for."""
    WILDEST = 10.0
    """No filter opens with a lambda beyond this: it was learnt from what was no measurement."""

    def __init__(
        self,
        settings: Adaptation,
        filters: RateFilters,
        evidence: Evidence,
        noise: ProcessNoise,
        ranges: Ranges | None,
        motions: Uncommanded | None,
        limited: slice,
        dt: float,
    ) -> None:
        """``limited``: rows of the filters that look for a range, if any."""
        self._settings, self._filters, self._evidence, self._noise = settings, filters, evidence, noise
        self._ranges, self._motions, self._limited = ranges, motions, limited
        self.opening, self.past = Opening(settings, dt), Recollection(settings, dt)
        self._believed_before = np.ones(N_ACTION)
        self.reset()

    def reset(self) -> None:
        """Start a new flight: a healthy aircraft, and no alarm."""
        self.start_anew(self._settings.effectiveness_sd)
        self._noise.opened = False
        self.opening.reset()
        self.past.reset()
        self._refuted = False
        """Whether what an alarm was raised for is that no surface moves by itself as far as was believed."""

    def start_anew(self, effectiveness_sd: float) -> None:
        """Take every filter to a healthy aircraft with lambda as sure as said."""
        f = self._filters
        f.s[:] = 0.0
        f.s[:, LAMBDA] = 1.0
        self._spread(effectiveness_sd)
        if self._motions:
            self._motions.rest(np.ones(N_ACTION))
        if self._ranges:
            self._ranges.reset()

    def begin(self, believed: np.ndarray, refuted: bool) -> None:
        """Take it that this sample raised an alarm; believed (3,): lambda as it was imagined; refuted: as above."""
        self.past.recall(self.opening.calm)
        self.opening.begin()
        self._refuted = refuted
        np.copyto(self._believed_before, believed)

    def step(self, w: list[float], blind: Sequence[bool], acting: np.ndarray, limited: int | None) -> None:
        """Go on by a sample: open the filters, or close them, where it is time to.

        w (3,): measured rates [rad/s]; blind (3,): whether p, q, r tell nothing; acting (3,): the commands that act
        [rad]; limited: the surface that is believed to have lost some of its range, or None.
        """
        settings, f = self._settings, self._filters
        self.opening.step()
        if self.opening.opens:
            f.s[:] = self.past.recalled
            f.s[:, W] = w
            np.clip(f.s[:, LAMBDA], -self.WILDEST, self.WILDEST, out=f.s[:, LAMBDA])
            self._spread(settings.effectiveness_sd_open, settings.open_slopes)
            for surface, axis in enumerate(AXIS):
                if blind[axis]:
                    f.variances[:, LAMBDA.start + surface] = settings.effectiveness_sd**2
            if self._ranges:
                self._look_for_ranges(self._ranges, acting, limited)
            if self._motions:
                self._motions.open(self.past.settled)
            self._noise.opened = True
            if self._refuted:
                self._evidence.believed, self._refuted = 0, False
            self._evidence.forget()
        elif self.opening.closes:
            self._noise.opened = False
            if self._ranges:
                self._ranges.close()

    def undo(self, believed: np.ndarray) -> None:
        """Forget what was learnt of late, and the opening that it may have asked for; believed (3,): as imagined."""
        f = self._filters
        now = f.s[:, W].copy()
        if self.opening.under_way:
            f.s[:], believed[:] = self.past.recalled, self._believed_before
            if not self.opening.pending:
                self._spread(self._settings.effectiveness_sd)
                self._noise.opened = False
            self.opening.cut_short()
        else:
            f.s[:] = self.past.before()
        f.s[:, W] = now
        if self._motions:
            self._motions.rest(self._motions.effectiveness)
        if self._ranges:
            self._ranges.restore()
        self._evidence.forget()

    def _spread(self, effectiveness_sd: float, slopes: tuple[float, float] = (0.0, 0.0)) -> None:
        """Forget correlations and set the variances of open filters."""
        f, settings = self._filters, self._settings
        f.P[:] = 0.0
        f.variances[:, W], f.variances[:, LAMBDA] = settings.open_rate**2, effectiveness_sd**2
        f.variances[:, B] = np.square(settings.open_bias)
        f.variances[:, SLOPES] = np.square(slopes)

    def _look_for_ranges(self, ranges: Ranges, acting: np.ndarray, limited: int | None) -> None:
        """Open the filters that look for a range: nothing but it has changed.

        limited: the surface that is believed to have lost some of its range, or None. If its ends are known, and the
        filters had closed before this alarm, its filter is right whatever has changed besides, and opens as all others.
        """
        f, rows = self._filters, self._limited
        sure = limited is not None and ranges.of[limited].limited and not self.opening.again
        works = self.past.long_ago[LAMBDA].tolist()
        for surface, each in enumerate(works):
            if sure and surface == limited:
                continue
            row = rows.start + surface
            f.s[row, RATES:] = self.past.long_ago[RATES:]
            f.variances[row, LAMBDA], f.variances[row, SLOPES] = self._settings.effectiveness_sd**2, 0.0
            if abs(each) >= Ranges.WORKS:
                f.variances[row, B] *= self.STEADY**2
        ranges.open(acting.tolist(), works, limited, sure)
