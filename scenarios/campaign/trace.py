"""What an aircraft did in a flight, and where it was lost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from task.reward import terminated
from task.state import N_ACTION, N_STATE

LOOK = 25
"""So often a flight is looked at whether it is lost [samples]; the loss itself is found exactly."""


class Trace(NamedTuple):
    """What the aircraft did."""

    x: np.ndarray
    """(T, 12) true states until the end or the loss."""
    command: np.ndarray
    """(T, 3) commands [rad]."""
    rows: np.ndarray
    """(N, 3) the reference of the whole flight [rad]."""


class Course:
    """A flight as it goes on: states and the commands that answer them."""

    def __init__(self, rows: np.ndarray) -> None:
        """Take the reference (N, 3) [rad]."""
        self.rows = rows
        self.x = np.zeros((len(rows), N_STATE))
        """True states; those from ``ticks`` on mean nothing yet."""
        self.command = np.zeros((len(rows), N_ACTION))
        """[rad]"""
        self.ticks = 0
        """States seen."""

    def see(self, x: np.ndarray) -> bool:
        """Take the next true state; return True once in a while when the aircraft was lost lately."""
        self.x[self.ticks] = x
        self.ticks += 1
        return self.ticks % LOOK == 0 and bool(terminated(self.x[self.ticks - LOOK : self.ticks]).any())

    def trace(self) -> Trace:
        """Return the flight until its end or the sample in which it was lost."""
        lost = np.flatnonzero(terminated(self.x[: self.ticks]))
        end = int(lost[0]) if lost.size else self.ticks
        return Trace(self.x[:end], self.command[:end], self.rows)
