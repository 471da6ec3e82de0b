"""Two processes are watched until both have ended, whatever happens to either."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from scenarios import processes
from scenarios.processes import Process, StoppedError, ended_as_by_ctrl_c, free_port, supervise
from task.errors import UserError


def serving(name: str, folder: Path) -> Process:
    """Return a process that never ends by itself."""
    return Process(name, "http.server", ["0", "--bind", "127.0.0.1"], folder / f"{name}.log")


def failing(name: str, folder: Path) -> Process:
    """Return a process that ends with one line and code 2."""
    return Process(name, "zipfile", ["--nonsense"], folder / f"{name}.log")


def ending(name: str, folder: Path) -> Process:
    """Return a process that ends well at once."""
    return Process(name, "this", [], folder / f"{name}.log")


def gone(process: Process) -> bool:
    try:
        os.kill(process.pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_a_process_that_fails_ends_the_other_and_is_quoted(tmp_path: Path) -> None:
    runtime, bridge = failing("runtime", tmp_path), serving("bridge", tmp_path)
    with pytest.raises(UserError, match=r"^runtime: zipfile.*required") as caught:
        supervise(runtime, bridge, threading.Event(), lambda: 0.0)
    assert "\n" not in str(caught.value)
    assert gone(runtime)
    assert gone(bridge)


def test_a_process_that_is_killed_ends_the_other(tmp_path: Path) -> None:
    runtime, bridge = serving("runtime", tmp_path), serving("bridge", tmp_path)
    threading.Timer(0.3, os.kill, (bridge.pid, 9)).start()
    with pytest.raises(UserError, match="bridge was ended by signal 9"):
        supervise(runtime, bridge, threading.Event(), lambda: 0.0)
    assert gone(runtime)


def test_both_end_well(tmp_path: Path) -> None:
    seen: list[float] = []
    supervise(ending("runtime", tmp_path), ending("bridge", tmp_path), threading.Event(), lambda: 0.5, seen.append)
    assert set(seen) <= {0.5}


def test_a_stop_ends_both(tmp_path: Path) -> None:
    runtime, bridge, stop = serving("runtime", tmp_path), serving("bridge", tmp_path), threading.Event()
    threading.Timer(0.3, stop.set).start()
    with pytest.raises(StoppedError):
        supervise(runtime, bridge, stop, lambda: 0.0)
    assert gone(runtime)
    assert gone(bridge)


def test_one_that_outlives_the_flight_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "FOLLOW", 0.3)
    runtime = serving("runtime", tmp_path)
    with pytest.raises(UserError, match="runtime did not end with the flight"):
        supervise(runtime, ending("bridge", tmp_path), threading.Event(), lambda: 0.0)
    assert gone(runtime)


def test_a_flight_that_stands_still_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "STALL", 0.5)
    began = time.monotonic()
    with pytest.raises(UserError, match="stood still"):
        supervise(serving("runtime", tmp_path), serving("bridge", tmp_path), threading.Event(), lambda: 0.7)
    assert time.monotonic() - began < 5.0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_closed_terminal_and_a_kill_are_as_ctrl_c_and_nohup_stays(number: signal.Signals) -> None:
    heard: list[int] = []
    before = signal.signal(number, lambda *_: heard.append(1))
    try:
        with pytest.raises(KeyboardInterrupt), ended_as_by_ctrl_c():
            signal.raise_signal(number)
        signal.raise_signal(number)
        assert heard == [1], "the handler of before is back"
        signal.signal(number, signal.SIG_IGN)
        with ended_as_by_ctrl_c():
            signal.raise_signal(number)
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


def test_ports_are_not_handed_out_twice() -> None:
    ports = [free_port() for _ in range(50)]
    assert len(set(ports)) == len(ports)
