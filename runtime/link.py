"""What the loop needs of the other side: an interface of four verbs.

MAVLink over UDP stands behind it in flight (:mod:`runtime.mavlink_link`); an in-process plant can take its place.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

OVER, LOST = "over", "lost"
"""How the aircraft's side says that a flight ended."""


class Severity:
    """How urgent a line is, as in MAV_SEVERITY."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6


class Sample(NamedTuple):
    """One state: its simulated time [us], the flight that it belongs to, and x (12,) (task.state)."""

    time_usec: int
    flight: int
    x: np.ndarray


class Link(Protocol):
    """What the loop needs of the other side; an in-process plant can take MAVLink's place."""

    ended: str
    """``over`` or ``lost`` once the other side has said so; empty in flight."""
    skipped: int
    """States that were there but older than another (real time, or in one datagram with it)."""
    repeated: int
    """States that came again and were answered again."""

    def read(self, timeout: float) -> Sample | None:
        """Return the next state; None when none comes within ``timeout`` [s] or the flight ended."""

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Send the command (3,) [rad] that answers the state of ``time_usec``."""

    def say(self, text: str, severity: int) -> None:
        """Tell who listens on the link a line; severity as in MAV_SEVERITY."""

    def diagnosis(self) -> str:
        """Return in words why no state came."""

    def close(self) -> None:
        """Let go of the link."""
