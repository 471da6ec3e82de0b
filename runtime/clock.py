"""Keeping time: simulated time as it comes, or wall time with missed samples counted and never repaid."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Protocol


class Clock(Protocol):
    """How long to wait for the next sample, and what it means that it did not come."""

    missed: int

    def wait(self) -> float:
        """Return how long to wait for the next sample [s]; 0 when it is overdue."""

    def arrived(self) -> None:
        """Note that a sample came: the next one is due a sample time later."""

    def overdue(self) -> bool:
        """Return whether a sample has been missed since the last call; count it when it has."""


class SteppedClock:
    """Simulated time: the next sample comes when the other side sends it, and none is ever missed."""

    SLICE = 0.2
    """How long one wait lasts [s], so that the link's housekeeping goes on."""

    missed = 0

    def wait(self) -> float:
        """Return the length of a slice [s]."""
        return self.SLICE

    def arrived(self) -> None:
        """Do nothing: time does not run."""

    def overdue(self) -> bool:
        """Return False: nobody is late."""
        return False


class RateKeeper:
    """Wall time in samples of ``dt`` [s]: each sample sets when the next is due.

    A sample that has not come ``factor`` sample times after the last counts as missed, and from there each further
    sample time counts one more. An overrun is skipped: deadlines that passed unseen are counted at once and the next
    lies in the future, so that nothing is repaid in a burst.
    """

    def __init__(self, dt: float, factor: float = 1.5) -> None:
        self._dt = dt
        self._grace = factor * dt
        self.missed = 0
        self._deadline = time.monotonic() + self._grace

    def wait(self) -> float:
        """Return the time left to the deadline [s], not below zero."""
        return max(self._deadline - time.monotonic(), 0.0)

    def arrived(self) -> None:
        """Set the deadline of the next sample from the arrival of this one."""
        self._deadline = time.monotonic() + self._grace

    def overdue(self) -> bool:
        """Return whether the deadline has passed; count it and those that passed with it, and set the next one."""
        late = time.monotonic() - self._deadline
        if late < 0.0:
            return False
        skipped = 1 + int(late / self._dt)
        self.missed += skipped
        self._deadline += skipped * self._dt
        return True


@contextmanager
def hardened(core: int, priority: int = 50) -> Iterator[list[str]]:
    """Ask the system for real-time behaviour of this thread; yield a line for each thing asked, got or not.

    SCHED_FIFO (threads started later do not inherit it), memory locked, the thread pinned to ``core`` (-1: not), no
    garbage collection in flight, short turns of the interpreter lock. Nothing here fails. At the end all of it is as it
    was found: the process may go on to something else.
    """
    report = []
    with ExitStack() as undo:
        try:
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
            undo.callback(_schedule, *before)
            report.append(f"real time: SCHED_FIFO, priority {priority}")
        except (OSError, AttributeError) as error:
            report.append(
                f"real time: no SCHED_FIFO ({_why(error)}); allow it with 'setcap cap_sys_nice' or limits.conf"
            )
        try:
            current = 1  # not future: under a small limit that would make later allocations fail
            libc, locked = ctypes.CDLL(None, use_errno=True), _memory_is_locked()
            if libc.mlockall(current) != 0:
                raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
            if not locked:
                undo.callback(libc.munlockall)
            report.append("real time: memory locked")
        except (OSError, AttributeError) as error:
            report.append(f"real time: memory not locked ({_why(error)}); raise 'ulimit -l'")
        if core >= 0:
            try:
                cores = os.sched_getaffinity(0)
                os.sched_setaffinity(0, {core})
                undo.callback(os.sched_setaffinity, 0, cores)
                report.append(f"real time: pinned to core {core}")
            except (OSError, AttributeError, ValueError) as error:
                report.append(f"real time: not pinned to core {core} ({_why(error)})")
        if gc.isenabled():
            undo.callback(gc.enable)
        if not gc.get_freeze_count():
            undo.callback(gc.unfreeze)
        undo.callback(sys.setswitchinterval, sys.getswitchinterval())
        gc.collect()
        gc.freeze()
        gc.disable()
        sys.setswitchinterval(5e-4)
        yield report


def _schedule(policy: int, parameters: os.sched_param) -> None:
    """Schedule this thread as it was; who may not take back the reset on fork keeps it, which is for children alone."""
    for wanted in (policy, policy | os.SCHED_RESET_ON_FORK):
        with suppress(OSError):
            os.sched_setscheduler(0, wanted, parameters)
            return


def _memory_is_locked() -> bool:
    """Return whether somebody has locked memory of this process before."""
    status = Path("/proc/self/status").read_text()
    return any(line.startswith("VmLck:") and int(line.split()[1]) > 0 for line in status.splitlines())


def _why(error: Exception) -> str:
    """Return the system's reason."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
