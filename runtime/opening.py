"""What follows an alarm: when the filters open, when they close again, and what of the past they start from."""

from __future__ import annotations

import numpy as np

from runtime.config import Adaptation
from runtime.rate_filter import LAMBDA, MOTION, N
from task.state import N_ACTION


class Opening:
    """Counts the samples since the last alarm, and says what they mean.

    ``open_after`` the alarm the filters open, for ``open_time``; for ``watch`` what has changed is looked for. Once a
    sample: :meth:`step`, and :meth:`begin` where there is an alarm.
    """

    CALM = 5.0
    """So long after the filters have closed nothing has changed lately [s]."""

    def __init__(self, settings: Adaptation, dt: float) -> None:
        self._opens_at = max(round(settings.open_after / dt), 1)
        self._closes_at = self._opens_at + max(round(settings.open_time / dt), 1)
        self._hold = round(settings.alarm_hold / dt)
        self._watched_until = round(settings.watch / dt)
        self._calm_at = self._closes_at + round(self.CALM / dt)
        self.reset()

    def reset(self) -> None:
        """Start a new flight: whatever there was is over."""
        self._since = max(self._closes_at + self._hold, self._watched_until)
        self.again = False
        """Whether the last alarm came before the filters had closed after the one before."""

    def begin(self) -> None:
        """Count from this sample's alarm on."""
        self.again, self._since = self.under_way, 0

    def step(self) -> None:
        """Go on by a sample."""
        self._since += 1

    def cut_short(self) -> None:
        """Take the filters to have closed by now: there was nothing to look for."""
        self._since = self._closes_at

    @property
    def opens(self) -> bool:
        """Whether the filters open in this sample."""
        return self._since == self._opens_at

    @property
    def closes(self) -> bool:
        """Whether they close in this sample."""
        return self._since == self._closes_at

    @property
    def pending(self) -> bool:
        """Whether there was an alarm, and the filters, of an aircraft that is no more, have not opened yet."""
        return self._since < self._opens_at

    @property
    def under_way(self) -> bool:
        """Whether there was an alarm, and the filters have not closed since."""
        return self._since < self._closes_at

    @property
    def closed(self) -> bool:
        """Whether the filters had closed before this sample."""
        return self._since > self._closes_at

    @property
    def searching(self) -> bool:
        """Whether the filters have opened, less than ``watch`` after the alarm."""
        return self._opens_at <= self._since < self._watched_until

    @property
    def calm(self) -> bool:
        """Whether they have been closed for long."""
        return self._since > self._calm_at

    @property
    def may_begin(self) -> bool:
        """Whether the last alarm is ``alarm_hold`` ago."""
        return self._since > self._hold


class Recollection:
    """What the believed filter knew in the last second, in a ring, and what is recalled of it at an alarm."""

    LONG_AGO = 1.0
    """Filters that look for a range start from what was known so long before the alarm [s]: a surface that does not
    come back from its limit is soon taken for one that does little."""

    def __init__(self, settings: Adaptation, dt: float) -> None:
        self._back = max(round(settings.recall / dt), 1)
        self._ring = np.zeros((max(round(self.LONG_AGO / dt), self._back), N))
        self._kept = 0
        """Samples since the flight began, those that are missing left out: a gap lasts for none."""
        self.recalled, self.long_ago = np.zeros(N), np.zeros(N)
        """State (11,) as it was ``recall`` and ``LONG_AGO`` before the last alarm."""
        self.settled = np.ones(N_ACTION)
        """lambda (3,) as it was before the last alarm that came in calm. What is believed between the alarms of a
        series is mostly what they were raised for: it is wrong."""

    def reset(self) -> None:
        """Start a new flight, with a healthy aircraft."""
        self._ring[:] = 0.0
        self._ring[:, LAMBDA] = self.settled[:] = 1.0

    def before(self) -> np.ndarray:
        """Return what was known ``recall`` before this sample (11,), a view."""
        return self._ring[self._kept % len(self._ring) - self._back]

    def recall(self, calm: bool) -> None:
        """Set aside what was known before this sample's alarm; calm: whether nothing had changed lately."""
        np.copyto(self.recalled, self.before())
        np.copyto(self.long_ago, self._ring[self._kept % len(self._ring)])
        if calm:
            np.copyto(self.settled, self.long_ago[LAMBDA])

    def keep(self, state: np.ndarray, effectiveness: np.ndarray, moving: bool) -> None:
        """Keep this sample's state (11,), with lambda (3,) in place of its own; the next sample comes.

        moving: whether one of its slopes is how fast a surface moves by itself.
        """
        now = self._ring[self._kept % len(self._ring)]
        self._kept += 1
        np.copyto(now, state)
        now[LAMBDA] = effectiveness
        if moving:
            now[MOTION] = 0.0
