"""What goes to the runtime, in the order of docs/interface.md."""

from __future__ import annotations

import time

import numpy as np

from sim_bridge.codec import Codec, Status
from sim_bridge.link import Link
from task.state import STATE

CALM = 1e-6
"""Wind below this is still air [m/s]: the rounding of a simulator that adds winds up."""
BEAT = 1.0
"""Period of HEARTBEAT and GPS_GLOBAL_ORIGIN [s of wall clock]."""
FAREWELLS = 3
FAREWELL_SPACING = 0.02
"""The last HEARTBEAT goes out this many times, this far apart [s]: no later one would make up for it."""


class Sender:
    """Sends ticks and status, and remembers the last tick so that it can be sent again.

    lockstep: what HEARTBEAT says about time.
    """

    def __init__(self, link: Link, codec: Codec, lockstep: bool) -> None:
        self._link = link
        self._codec = codec
        self._lockstep = lockstep
        self._next_beat = 0.0
        self._connected = False
        self._tick: tuple[int, np.ndarray, np.ndarray] | None = None

    def tick(self, time_us: int, measured: np.ndarray, wind_n: np.ndarray) -> None:
        """Send WIND_COV when there is wind (3,) [m/s], then ODOMETRY of the measured state (12,).

        The first tick is only kept: ``again`` sends it until somebody answers.
        """
        self._tick = time_us, measured, wind_n
        if not self._connected:
            return
        if time.perf_counter() >= self._next_beat:
            self._beat(Status.FLYING, time_us)
        self._send_tick(time_us, measured, wind_n)

    def again(self) -> None:
        """Send the last tick again, with all that somebody who has just come needs."""
        if self._tick is not None:
            self._beat(Status.WAITING, self._tick[0])
            self._send_tick(*self._tick)

    def once_more(self) -> None:
        """Send the last tick again, as it was."""
        if self._tick is not None:
            self._send_tick(*self._tick)

    def flying(self) -> None:
        """Say that somebody answers and simulated time runs (again)."""
        self._connected = True
        self._link.send(self._codec.heartbeat(Status.FLYING, self._lockstep))

    def farewell(self, status: int) -> None:
        """Say how the flight ended."""
        for n in range(FAREWELLS):
            if n:
                time.sleep(FAREWELL_SPACING)
            self._link.send(self._codec.heartbeat(status, self._lockstep))

    def _beat(self, status: int, time_us: int) -> None:
        self._next_beat = time.perf_counter() + BEAT
        self._link.send(self._codec.heartbeat(status, self._lockstep))
        self._link.send(self._codec.origin(time_us))

    def _send_tick(self, time_us: int, measured: np.ndarray, wind_n: np.ndarray) -> None:
        if np.abs(wind_n).max() > CALM:
            self._link.send(self._codec.wind(time_us, wind_n, float(measured[STATE.h])))
        self._link.send(self._codec.odometry(time_us, measured))
