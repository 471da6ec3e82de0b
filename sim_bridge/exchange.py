"""One state out, one command back: in lockstep or in real time, with a runtime that may come and go."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sim_bridge.codec import Command
from sim_bridge.inbox import Counts, Inbox
from sim_bridge.link import Link
from sim_bridge.pace import Pace
from sim_bridge.sender import Sender
from task.config import Settings
from task.limits import DT

TICK_US = round(DT * 1e6)
"""Simulated time of one tick [us]."""

_SLICE = 0.05
"""Longest wait that does not look whether the flight was stopped [s]."""


class Timing(Settings, frozen=True):
    """How long the bridge waits for the runtime; all in wall clock."""

    patience: float = 30.0
    """How long nobody may answer, at the start or in flight, before the flight is given up [s]."""
    reply_timeout: float = 2.0
    """How long one reply is waited for in lockstep [s]."""
    resend: float = 0.1
    """How often the last state is sent again while nobody answers [s]."""
    lost_after: int = 3
    """Late replies in a row after which the link counts as lost and simulated time stands still (lockstep)."""


class NoRuntimeError(Exception):
    """The patience is over; the message says who did not answer and what was heard."""


class StoppedError(Exception):
    """The flight was stopped from outside."""


class Exchange(Protocol):
    """Turns the tick that has just been sent into the command to apply."""

    echo: int
    connected_at: float
    response: list[float]

    def command(self, time_us: int) -> np.ndarray:
        """Return the command (3,) [rad] to apply from the state at ``time_us`` [us] on.

        Raises NoRuntimeError and StoppedError.
        """


@dataclass(frozen=True, slots=True)
class Ends:
    """What an exchange works with."""

    link: Link
    sender: Sender
    inbox: Inbox
    counts: Counts
    timing: Timing
    initial_command: np.ndarray
    """In force until the first reply [rad], shape (3,): the trim's."""
    stopped: Callable[[], bool]
    """Whether the flight was stopped from outside."""
    say: Callable[[str], None]
    """Takes one line about what happens to the link."""


class _Base:
    """What both ways of time share: the command in force, the connection and the judgement of replies."""

    def __init__(self, ends: Ends) -> None:
        self._link = ends.link
        self._sender = ends.sender
        self._inbox = ends.inbox
        self._counts = ends.counts
        self._timing = ends.timing
        self._stopped = ends.stopped
        self._say = ends.say
        self._action = ends.initial_command
        self._connected = False
        self._sent_again = -1
        self._repeated_answer = -1
        self._late_run = 0
        self._sent_at = 0.0
        self.echo = -1
        """Time of the state that the command in force answers [us]; -1 before the first."""
        self.connected_at = 0.0
        """When the first reply came [s, time.perf_counter]; 0 before it."""
        self.response: list[float] = []
        """Wall clock from each tick to its own reply [s]; ticks without one are left out."""

    def _judge(self, command: Command, time_us: int) -> bool:
        """Return whether a command is an answer to the state at ``time_us``, good or refused; count what is not."""
        if command.time_us > time_us or command.time_us % TICK_US:
            self._counts.refused["unknown echo"] += 1
            return False
        if command.refusal:
            self._counts.refused[command.refusal] += 1
        if command.time_us == time_us:
            return True
        # A state that was sent again is answered again, and a runtime that misses a state repeats itself: no fault.
        self._counts.stale += command.time_us not in (self._repeated_answer, self.echo)
        return False

    def _accept(self, command: Command) -> None:
        """Put a command into force; a refused one leaves the last in force."""
        if command.time_us == self._sent_again:
            self._repeated_answer = command.time_us
        if command.action is not None:
            self._action = command.action
            self.echo = command.time_us

    def _count_late(self) -> None:
        self._counts.late += 1
        self._late_run += 1
        self._counts.longest_late_run = max(self._counts.longest_late_run, self._late_run)

    def _await_runtime(self, time_us: int) -> None:
        """Send the last tick again and again until a good reply to it is there."""
        began = time.perf_counter()
        self._sent_again = time_us
        while True:
            if self._stopped():
                raise StoppedError
            if time.perf_counter() - began > self._timing.patience:
                raise NoRuntimeError(
                    f"no answer from {self._link.address} to ODOMETRY at {time_us * 1e-6:.2f} s of flight for "
                    f"{self._timing.patience:g} s: {self._inbox.heard()}; "
                    "start the runtime there, or check the address (docs/interface.md)"
                )
            self._sender.again()
            if self._answered(time_us, time.perf_counter() + self._timing.resend):
                break
        if not self._connected:
            self._say(f"runtime at {self._link.address} answers")
            self.connected_at = time.perf_counter()
        self._connected = True
        self._late_run = 0
        self._link.refused = False
        self._sender.flying()

    def _answered(self, time_us: int, until: float) -> bool:
        """Return whether a good reply comes by ``until``; sleeps it out when the port is closed."""
        while time.perf_counter() < until:
            command = self._inbox.next(until)
            if command is None:
                if self._link.refused:
                    self._link.refused = False
                    time.sleep(max(until - time.perf_counter(), 0.0))
                continue
            if self._judge(command, time_us) and command.action is not None:
                self._accept(command)
                return True
        return False


class Lockstep(_Base):
    """Each state is answered before the next is sent; simulated time waits."""

    def command(self, time_us: int) -> np.ndarray:
        """Wait, bounded, for the command that echoes ``time_us``; hold the last one when it does not come."""
        if not self._connected:
            self._await_runtime(time_us)
            return self._action
        if self._stopped():  # a runtime that answers at once leaves no pause to ask in
            raise StoppedError
        self._sent_at = time.perf_counter()
        if not self._wait(time_us):
            lost = self._link.refused
            if not lost:
                self._count_late()
                lost = self._late_run >= self._timing.lost_after
            if lost:
                self._reconnect(time_us)
        return self._action

    def _wait(self, time_us: int) -> bool:
        """Return whether the reply comes in time; at half time the state is sent once more.

        That makes up for a lost datagram, and finds a closed port when the first one died with the runtime.
        """
        until = self._sent_at + self._timing.reply_timeout
        half_time = self._sent_at + 0.5 * self._timing.reply_timeout
        while (now := time.perf_counter()) < until:
            if now > half_time and self._sent_again != time_us:
                self._sent_again = time_us
                self._sender.once_more()
            command = self._inbox.next(min(until, now + _SLICE))
            if command is not None and self._judge(command, time_us):
                self.response.append(time.perf_counter() - self._sent_at)
                self._accept(command)
                self._late_run = 0
                return True
            if self._link.refused:
                return False
            if self._stopped():
                raise StoppedError
        return False

    def _reconnect(self, time_us: int) -> None:
        began = time.perf_counter()
        self._say(f"link lost at {time_us * 1e-6:.2f} s of flight; simulated time stands still")
        self._await_runtime(time_us)
        self._counts.reconnections += 1
        self._say(f"runtime is back after {time.perf_counter() - began:.1f} s; the flight goes on")


class RealTime(_Base):
    """The wall clock is the master: whatever is there at the deadline is applied."""

    def __init__(self, ends: Ends, pace: Pace) -> None:
        super().__init__(ends)
        self._pace = pace
        self._heard_at = 0.0

    def command(self, time_us: int) -> np.ndarray:
        """Wait for the deadline of this tick and return the newest command that has come by then."""
        if not self._connected:
            self._await_runtime(time_us)
            self._pace.start()
            self._heard_at = time.perf_counter()
        self._sent_at = time.perf_counter()
        until = self._pace.next()
        while True:
            command = self._inbox.next(until)
            if command is not None:
                self._take(command, time_us)
            if time.perf_counter() >= until:
                break
        self._counts.overruns += self._pace.woken()
        self._check(time_us)
        return self._action

    def _take(self, command: Command, time_us: int) -> None:
        """Put a command into force when it answers a newer state than the one in force."""
        if self._judge(command, time_us) and self.echo < time_us:
            self.response.append(time.perf_counter() - self._sent_at)
        if self.echo < command.time_us <= time_us and command.action is not None:
            self._accept(command)
            self._heard_at = time.perf_counter()

    def _check(self, time_us: int) -> None:
        if self._stopped():
            raise StoppedError
        if self.echo == time_us:
            if self._late_run >= self._timing.lost_after:
                self._counts.reconnections += 1
            self._late_run = 0
            return
        self._count_late()
        if time.perf_counter() - self._heard_at > self._timing.patience:
            raise NoRuntimeError(
                f"no answer from {self._link.address} since {self.echo * 1e-6:.2f} s of flight, for "
                f"{self._timing.patience:g} s: {self._inbox.heard()}; start the runtime again within that time"
            )
