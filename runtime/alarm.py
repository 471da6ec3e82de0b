"""When the aircraft answers otherwise than any hypothesis has it: three signs, each with its threshold."""

from __future__ import annotations

import math

from runtime.config import Adaptation
from runtime.shift import Shift
from task.state import N_ACTION


class Alarm:
    """Surprise of all hypotheses, an agile filter's lead, and a bias that has left its running mean.

    Once a sample: :meth:`compare` with what the agile filters make of it, then :meth:`sounds`.
    """

    WINDOW = 5
    """Samples whose normalised innovations squared add up to the surprise."""
    HOLD = 3
    """Samples for which an agile filter must lead."""
    BEYOND = 1e9
    """Largest normalised innovation squared; what is more, or no number, counts as this."""

    def __init__(self, settings: Adaptation, dt: float) -> None:
        self._settings = settings
        self.shift = Shift(settings.q_bias, settings.shift_time, dt)
        """Of the believed filter's bias; who feeds the alarm keeps it up to date."""
        self.restart()
        self.clear()

    def restart(self) -> None:
        """Forget the last samples: the next ones follow a gap, or another aircraft."""
        self.forget_surprise()
        self._led = 0

    def forget_surprise(self) -> None:
        """Forget what the last samples' innovations were."""
        self._nis, self._newest = [0.0] * self.WINDOW, 0

    def clear(self) -> None:
        """Let the agile filters lead by nothing: they start anew."""
        self.leads = [0.0] * N_ACTION
        """By how much each surface's agile filter leads the believed one, with forgetting [nats]."""

    def compare(self, moving: list[float], known: float) -> None:
        """Take the log-likelihoods of a sample: of each agile filter, and of what is known."""
        memory = self._settings.delay_memory
        self.leads = [max(memory * lead + new - known, 0.0) for lead, new in zip(self.leads, moving, strict=True)]

    def sounds(self, nis: float, levels: list[float]) -> bool:
        """Return whether any sign is up.

        nis: the normalised innovation squared of who explains the sample best; levels: of turbulence (3,), with which
        the thresholds on surprise and leads grow.
        """
        settings = self._settings
        self._newest = (self._newest + 1) % self.WINDOW
        self._nis[self._newest] = nis if nis < self.BEYOND else self.BEYOND
        colour = 1.0 + settings.alarm_colour * math.log(max(levels))
        moved = any(lead > colour * need for lead, need in zip(self.leads, settings.agile_lead, strict=True))
        self._led = self._led + 1 if moved else 0
        surprised = sum(self._nis) > settings.alarm_threshold * colour
        return surprised or self.shift.size > settings.alarm_shift or self._led >= self.HOLD
