"""Surfaces that stop short of their commands: one filter for each surface finds the range that it still has.

Within the range the surface does what it did before; beyond, it stays where the range ends. Such a filter's place of
that surface's lambda therefore holds where the surface is held, and is not used while it is free:

    held:   lambda_before B c            c, where the surface is, is estimated
    free:   lambda_before B u            known

The range is what the surface has been seen to reach. A command beyond it holds the surface until the rates tell that it
follows; when it does not, that end is known. A jammed surface has both ends at one place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from runtime.rate_filter import LAMBDA, RateFilters
from task.limits import DEFLECTION_LIMIT
from task.state import N_ACTION

LOW, HIGH = 0, 1
ALL = (-DEFLECTION_LIMIT, DEFLECTION_LIMIT)


class Range:
    """What is known of one surface."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """All the range, and an effectiveness of one."""
        self.reach, self.variance, self.known = list(ALL), [0.0, 0.0], [False, False]
        """Least and greatest deflection that was reached [rad], their variances [UNIT2], and whether more is not."""
        self.before: list[float | None] = [None, None]
        """Ends that were known before the filters opened."""
        self.effectiveness = 1.0
        """lambda before the alarm, taken to hold within the range."""
        self.sought, self.held = False, False
        """Whether nothing is known of where the surface is; whether the command is beyond its reach."""
        self.end = HIGH
        """The end that the filter's place of lambda stands for."""
        self.last = 0.0
        """The last command that acted [rad]."""

    @property
    def limited(self) -> bool:
        """Return whether an end of the range is known."""
        return True in self.known

    @property
    def ends(self) -> tuple[float, float]:
        """Return least and greatest deflection [rad], as far as they are known.

        A surface that ran away may be held beyond all that can be commanded.
        """
        low, high = (at if sure else free for at, sure, free in zip(self.reach, self.known, ALL, strict=True))
        return (low, max(low, high)) if self.known[LOW] else (min(low, high), high)


class Ranges:
    """The range of each surface, and what its filter is told of the deflection.

    Once a sample: :meth:`deflect` before the filters predict, :meth:`learn` after they are updated.
    """

    UNIT = 0.1
    """Deflection that one stands for in the place of lambda [rad]."""
    SURE = 0.0075
    """A place known as well as this tells whether the surface follows [rad]."""
    NEAR = 0.01
    """Closer to the command than this it may follow [rad]."""
    CREEP = 0.0002
    """Drift of the place in a sample, while that is so [rad]."""
    DOUBT = 0.5
    """Of a command's step beyond what was reached, that the surface follows."""
    WORKS = 0.3
    """A surface that was believed to work less than this may have been held all the time: it is taken to be healthy."""

    def __init__(self, filters: RateFilters, first: int) -> None:
        """``first``: row of the elevator's filter; aileron's and rudder's follow."""
        self._filters, self._first = filters, first
        self.of = [Range() for _ in range(N_ACTION)]
        """Elevator's, aileron's and rudder's."""
        self.acting = [0.0] * N_ACTION
        """Where each surface is, by its own filter [rad]."""

    def reset(self) -> None:
        """Every surface has all its range, and works as it should."""
        for each in self.of:
            each.reset()

    def open(self, u: list[float], effectiveness: list[float], believed: int | None, sure: bool) -> None:
        """Look anew for where each surface is.

        u (3,): the commands that act [rad]; effectiveness (3,): as believed before; believed: the surface whose range
        is believed to be limited, or None; sure: whether the filters had closed before this alarm. Its ends then stay
        where they are, else of two that are known the one that it is not at.
        """
        for surface, (each, command) in enumerate(zip(self.of, u, strict=True)):
            if sure and surface == believed:
                each.sought = False
                self._put(surface, each.reach[each.end], max(each.variance[each.end], (self.SURE / self.UNIT) ** 2))
                continue
            known = [at if told else None for at, told in zip(each.reach, each.known, strict=True)]
            each.reset()
            each.before = known if surface == believed else [None, None]
            works = effectiveness[surface]
            each.effectiveness = works if abs(works) >= self.WORKS else 1.0
            each.sought, each.last = True, command
            self._put(surface, command, 1.0)

    def close(self) -> None:
        """A surface that was not moved enough to tell has all its range."""
        for each in self.of:
            if each.sought:
                each.sought, each.reach = False, list(ALL)

    def deflect(
        self, u: list[float], coefficient: np.ndarray, known: np.ndarray, believed: int | None, followers: range
    ) -> None:
        """Set what the three filters multiply lambda with, and what they know of the deflections.

        u (3,): the commands that act [rad]; coefficient, known (3, 3): rows are filters, columns surfaces; believed:
        the surface whose range is believed to be limited, or None; ``followers``: other filters, with that one's
        column.
        """
        for surface, (each, command) in enumerate(zip(self.of, u, strict=True)):
            low, high = each.reach
            each.held = each.sought or not low <= command <= high
            if each.held:
                rows = (self._first + surface, *(followers if surface == believed else ()))
                if not each.sought:
                    self._load(surface, HIGH if command > high else LOW, rows)
                self._follow(surface, command, rows)
                self.acting[surface] = self._place(surface)
                coefficient[surface, surface], known[surface, surface] = each.effectiveness * self.UNIT, 0.0
            else:
                self.acting[surface] = command
                coefficient[surface, surface], known[surface, surface] = 0.0, each.effectiveness * command
            each.last = command

    def learn(self, u: list[float]) -> None:
        """Take what the filters have made of the measurement; u (3,) as in :meth:`deflect`."""
        for surface, (each, command) in enumerate(zip(self.of, u, strict=True)):
            if not each.held:
                continue
            variance = float(self._filters.variances[self._first + surface, LAMBDA.start + surface])
            sure = math.sqrt(max(variance, 0.0)) * self.UNIT < self.SURE
            at = self._place(surface)
            if each.sought:
                if not sure:
                    continue
                each.sought = False
                each.end = HIGH if command > at else LOW
                each.reach, each.variance = [at, at], [variance, variance]
                far = each.before[1 - each.end]
                if far is not None and (far < at if each.end == HIGH else far > at):
                    each.reach[1 - each.end], each.known[1 - each.end] = far, True
            else:
                limits = sorted((each.reach[each.end], command))
                if not limits[0] <= at <= limits[1] and not each.known[each.end]:
                    at = min(max(at, limits[0]), limits[1])
                    self._filters.s[self._first + surface, LAMBDA.start + surface] = at / self.UNIT
                each.reach[each.end], each.variance[each.end] = at, variance
            each.known[each.end] |= sure and abs(command - at) > self.NEAR
            if each.reach[LOW] > each.reach[HIGH]:
                each.reach[1 - each.end] = at

    def hear(self, told: list[float]) -> None:
        """Let, in the log-likelihoods of all hypotheses, a range without an end say what the first one says."""
        for row, each in enumerate(self.of, self._first):
            if not each.limited:
                told[row] = told[0]

    def restore(self) -> None:
        """Write the ends into the filters again, whose states were taken back."""
        self.close()
        for surface, each in enumerate(self.of):
            self._filters.s[self._first + surface, LAMBDA.start + surface] = each.reach[each.end] / self.UNIT

    def _follow(self, surface: int, command: float, rows: Sequence[int]) -> None:
        """Move a surface that may follow with its command, and doubt it: of what acts already, not from now on."""
        each, f, place = self.of[surface], self._filters, LAMBDA.start + surface
        if each.known[each.end]:
            return
        at = self._place(surface)
        if each.sought:
            step = command - each.last
        elif each.end == HIGH:
            step = max(command - max(each.last, at), 0.0)
        else:
            step = min(command - min(each.last, at), 0.0)
        near = abs(each.last - at) < self.NEAR
        for row in rows:
            if near:
                f.s[row, place] += step / self.UNIT
            # Doubt adds up: what held the surface in the last sample holds it in this one.
            sd = math.sqrt(max(float(f.P[row, place, place]), 0.0)) + (self.DOUBT * abs(step) + self.CREEP) / self.UNIT
            f.P[row, place, place] = sd * sd

    def _place(self, surface: int) -> float:
        """Return where the filter has the surface [rad]."""
        return self.UNIT * float(self._filters.s[self._first + surface, LAMBDA.start + surface])

    def _load(self, surface: int, end: int, rows: Sequence[int]) -> None:
        """Let the place of lambda stand for another end, with its own variance."""
        each = self.of[surface]
        if each.end != end:
            each.end = end
            self._put(surface, each.reach[end], each.variance[end], rows)

    def _put(self, surface: int, at: float, variance: float, rows: Sequence[int] = ()) -> None:
        """Set the place of lambda [rad] and its variance [UNIT2], related to nothing."""
        f, place = self._filters, LAMBDA.start + surface
        for row in rows or (self._first + surface,):
            f.P[row, place, :] = f.P[row, :, place] = 0.0
            f.P[row, place, place] = variance
            f.s[row, place] = at / self.UNIT
