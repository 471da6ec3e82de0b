"""Deadlines of a fixed-rate loop in wall clock: drift-free, and an overrun is skipped, never repaid."""

from __future__ import annotations

import time

import numpy as np


class Pace:
    """Deadline n is start + n * period, whatever happened before it.

    period [s]; capacity: how many wake-ups are remembered for the jitter.
    """

    def __init__(self, period: float, capacity: int) -> None:
        self._period = period
        self._start = 0.0
        self._n = 0
        self._lateness = np.zeros(capacity)
        self._woken = 0

    def start(self) -> None:
        """Begin now: the first deadline is one period ahead."""
        self._start = time.perf_counter()
        self._n = 0

    def next(self) -> float:
        """Return the next deadline [s, time.perf_counter]."""
        self._n += 1
        return self._start + self._n * self._period

    def woken(self) -> int:
        """Note a wake-up at the current deadline; return how many whole periods it came too late.

        Those deadlines are given up: the next one lies ahead again.
        """
        lateness = time.perf_counter() - (self._start + self._n * self._period)
        if self._woken < self._lateness.size:
            self._lateness[self._woken] = lateness
            self._woken += 1
        missed = max(int(lateness / self._period), 0)
        self._n += missed
        return missed

    def lateness(self) -> np.ndarray:
        """Return how late each wake-up was [s], shape (wake-ups,)."""
        return self._lateness[: self._woken]
