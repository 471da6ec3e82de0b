"""Excitation on demand: a surface at its limit says nothing of its effectiveness until somebody moves it.

A law that pushes a reversed surface the wrong way ends at the limit, and stays there: the command is constant, so that
what the surface does cannot be told from what a moved centre of gravity or a gust does, neither by the filters nor by a
law that learns by itself. A pulse of some degrees towards the middle tells the two apart in less than 0.1 s.
"""

from __future__ import annotations

import math

import numpy as np

from runtime.config import Adaptation
from runtime.structured import Effectiveness
from task.limits import DEFLECTION_LIMIT, DT
from task.state import ACTION, N_ACTION


class Excitation:
    """Adds pulses to what the policy asks for, on a surface at its limit.

    After an alarm where its lambda is unsure; and at any time where it is believed to do nothing, which costs nothing
    if that is so. One surface at a time, since aileron and rudder move the same axes; ``excitation_time`` long, then
    nothing for ``REST`` or ``REST_DEAD`` on that surface. Near the stall an elevator that is believed to hold the nose
    down is left alone: with the centre of gravity far aft all of it is needed, and a pulse would take some away.
    """

    AT_LIMIT = 0.98
    """Share of the largest deflection that counts as the limit."""
    STILL = 5
    """Samples for which a command must have been there: who moves by himself needs no pulse."""
    REST = 0.1
    """From a pulse to the next one of the same surface [s]: the rates have answered by then."""
    REST_DEAD = 0.5
    """The same for a surface that is believed to do nothing [s]."""

    def __init__(self, settings: Adaptation, found: Effectiveness | None, dt: float = DT) -> None:
        """``found``: who knows how sure each lambda is; without, and with a pulse of zero size, nothing is added."""
        self._found = found if settings.excitation > 0.0 else None
        self._size, self._unsure = settings.excitation, settings.excitation_sd
        self._long = max(round(settings.excitation_time / dt), 1)
        self._rest, self._rest_dead = round(self.REST / dt), round(self.REST_DEAD / dt)
        self._still, self._resting = [0] * N_ACTION, [0] * N_ACTION
        self._pulsed, self._last, self._left = -1, -1, 0
        self._out = np.zeros(N_ACTION)
        self.pulses = 0
        """How many there were."""

    @property
    def surface(self) -> int:
        """Return the surface that has a pulse in this sample, or -1."""
        return self._pulsed

    def add(self, action: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad], with a pulse where one is due; ``action`` stays as it is."""
        found = self._found
        if found is None:
            return action
        asked = action.tolist()
        for surface, each in enumerate(asked):
            at_limit = abs(each) >= self.AT_LIMIT * DEFLECTION_LIMIT
            self._still[surface] = self._still[surface] + 1 if at_limit else 0
            self._resting[surface] = max(self._resting[surface] - 1, 0)
        if self._left == 0:
            self._pulsed = -1
            if max(self._still) >= self.STILL:
                self._begin(self._due(found, asked[ACTION.de]))
        if self._left == 0:
            return action
        self._left -= 1
        wanted = asked[self._pulsed]
        if not math.isfinite(wanted):
            return action
        np.copyto(self._out, action)
        within = min(max(wanted, -DEFLECTION_LIMIT), DEFLECTION_LIMIT)
        # A command that leaves its limit meanwhile moves by itself: the pulse takes it no further than to the middle.
        self._out[self._pulsed] = within - math.copysign(min(self._size, abs(within)), within)
        return self._out

    def _due(self, found: Effectiveness, elevator: float) -> list[int]:
        """Return for each surface how long it rests after a pulse [samples], 0 where none is due; elevator: asked."""
        believed = found.believed.tolist()
        due = [0 if each else self._rest_dead for each in believed]
        if found.searching:
            due = [self._rest if sd > self._unsure else rest for sd, rest in zip(found.sd.tolist(), due, strict=True)]
            if found.near_stall and elevator * believed[ACTION.de] > 0.0:
                due[ACTION.de] = 0
        return due

    def _begin(self, due: list[int]) -> None:
        """Begin a pulse where one is due: the elevator's first, since pitch diverges the fastest, then in turn."""
        for surface in (*range(self._last + 1, N_ACTION), *range(self._last + 1)):
            if due[surface] and self._still[surface] >= self.STILL and not self._resting[surface]:
                self._pulsed = self._last = surface
                self._left = self._long
                self._resting[surface] = self._long + due[surface]
                self.pulses += 1
                return
