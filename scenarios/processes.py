"""Starts the two processes of a flight, watches over them, and never leaves one behind."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from task.errors import UserError

POLL = 0.05
"""How often the processes are looked at [s]."""
FOLLOW = 20.0
"""How long one process may outlive the other after a flight [s]."""
STALL = 90.0
"""How long a flight may stand still before it is ended [s]; both processes give up sooner by themselves."""
GRACE = 5.0
"""How long a process may take to end when it is asked to [s]."""

_given: set[int] = set()
_lock = threading.Lock()


@contextmanager
def ended_as_by_ctrl_c() -> Iterator[None]:
    """Take SIGTERM, and the SIGHUP of a terminal that is closed, for Ctrl-C; what nohup has ignored stays ignored."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    taken = {number: handler for number, handler in before.items() if handler not in (signal.SIG_IGN, None)}
    for number in taken:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)


class StoppedError(Exception):
    """Somebody asked for the flight to be stopped."""


def free_port() -> int:
    """Return a UDP port of 127.0.0.1 that is free now and was not handed out before by this process."""
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = int(probe.getsockname()[1])
        with _lock:
            if port not in _given:
                _given.add(port)
                return port


class Process:
    """One process of a flight; what it says goes to a file."""

    def __init__(self, name: str, module: str, arguments: Sequence[str], said: Path) -> None:
        self.name = name
        self.said = said
        with said.open("wb") as file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
                start_new_session=True,  # Ctrl-C is for the runner, which ends both
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def code(self) -> int | None:
        """Exit code, or None while it runs."""
        return self._process.poll()

    def ask(self) -> None:
        """Ask it to end."""
        if self.code is None:
            self._process.terminate()

    def end(self) -> None:
        """Ask it to end, and insist after a while."""
        self.ask()
        try:
            self._process.wait(GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def last_line(self) -> str:
        """Return the last thing that it said, in one line."""
        lines = [line.strip() for line in self.said.read_text(errors="replace").splitlines() if line.strip()]
        return lines[-1] if lines else f"{self.name} said nothing; its output is {self.said}"


def supervise(
    runtime: Process,
    bridge: Process,
    stop: threading.Event,
    progress: Callable[[], float],
    tick: Callable[[float], None] = lambda fraction: None,
) -> None:
    """Watch a flight until both processes have ended well.

    progress: returns how far the flight is, anything that grows; tick: takes it, several times a second.
    A process that fails ends the other. Raises UserError with the failing process's own line, or StoppedError.
    """
    pair = (bridge, runtime)
    moved_at, far = time.monotonic(), 0.0
    first_end: float | None = None
    try:
        while any(p.code is None for p in pair):
            if stop.wait(POLL):
                raise StoppedError
            _raise_failure(pair)
            now = time.monotonic()
            if any(p.code is not None for p in pair):
                first_end = first_end or now
                if now - first_end > FOLLOW:
                    left = next(p for p in pair if p.code is None)
                    raise UserError(f"{left.name} did not end with the flight and was stopped; see {left.said}")
            if (reached := progress()) > far:
                moved_at, far = now, reached
                tick(far)
            if now - moved_at > STALL:
                raise UserError(f"the flight stood still for {STALL:g} s and was ended; see {bridge.said}")
        _raise_failure(pair)
    finally:
        for process in pair:
            process.ask()
        for process in pair:
            process.end()


def _raise_failure(pair: Sequence[Process]) -> None:
    """Raise the line of a process that failed; the runtime's when both did: the bridge then says only who is gone."""
    failed = sorted((p for p in pair if p.code), key=lambda p: p.name != "runtime")
    if failed:
        raise UserError(_explain(failed[0]))


def _explain(process: Process) -> str:
    code = process.code or 0
    if code < 0:
        return f"{process.name} was ended by signal {-code}; the flight is lost; its output is {process.said}"
    line = process.last_line().removeprefix("understudy: ")
    return line if line.startswith(process.name) else f"{process.name}: {line}"
