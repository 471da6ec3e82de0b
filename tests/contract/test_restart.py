"""Either side is killed in flight and started again: the aircraft flies on, or one line says why not; never a hang."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from scenarios.references import build, csv_bytes
from scenarios.schema import Scenario
from scenarios.trace import read_log, read_truth
from sim_bridge.flight import Flight
from task.reward import terminated

SECONDS = 30.0
TIMEOUT = 90.0
KILLED_AT = 3.0
"""About how far the flight is when a side is killed [s]; it takes several seconds of wall clock to its end."""
EARLIEST = 2.5
"""At least how far it is, as its log's size says it to a few percent [s]."""


class Stage:
    """A flight whose two sides can be started, killed and started again; everything is in ``folder``."""

    def __init__(self, folder: Path, cast: Path) -> None:
        self.folder = folder
        self._cast = cast
        self._started: list[subprocess.Popen[bytes]] = []
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        self.rows = build(Scenario(title="t", flight=Flight(duration=SECONDS)), folder)[0].rows
        (folder / "reference.csv").write_bytes(csv_bytes(self.rows))
        (folder / "flight.toml").write_text(f"duration = {SECONDS}\n")

    def _start(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.err").open("wb") as errors:
            process = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stderr=errors,
                cwd=self.folder,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )
        self._started.append(process)
        return process

    def runtime(self, name: str) -> subprocess.Popen[bytes]:
        """Start the runtime; its log is NAME.ulg."""
        return self._start(
            name, "runtime", "--link", f"udpin:127.0.0.1:{self._port}", "--population", str(self._cast),
            "--reference", "reference.csv", "--preset", "understudy", "--switch", "soft", "--log", f"{name}.ulg",
        )  # fmt: skip

    def bridge(self, name: str, *options: str) -> subprocess.Popen[bytes]:
        """Start the bridge; its truth is NAME.npz."""
        link = f"udpout:127.0.0.1:{self._port}"
        return self._start(
            name, "sim_bridge", "--flight", "flight.toml", "--link", link, "--truth", f"{name}.npz", *options
        )

    def said(self, name: str) -> str:
        """Return what a process said; there is never a traceback in it."""
        text = (self.folder / f"{name}.err").read_text()
        assert "Traceback" not in text
        return text

    def flown(self, log: str) -> float:
        """Return how far a log is [s]; 0 before it is there."""
        path = self.folder / log
        return 0.0 if not path.exists() else path.stat().st_size / 145 * 0.01

    def close(self) -> None:
        for process in self._started:
            process.kill()
            process.wait()


@pytest.fixture
def stage(tmp_path: Path, flying_cast: Path) -> Iterator[Stage]:
    made = Stage(tmp_path, flying_cast)
    yield made
    made.close()


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_the_runtime_is_killed_and_started_again(stage: Stage) -> None:
    first, bridge = stage.runtime("first"), stage.bridge("truth")
    wait_until(lambda: stage.flown("first.ulg") > KILLED_AT)
    os.kill(first.pid, signal.SIGKILL)
    second = stage.runtime("second")
    assert bridge.wait(TIMEOUT) == 0, stage.said("truth")
    assert second.wait(TIMEOUT) == 0, stage.said("second")
    flight = read_truth(stage.folder / "truth.npz", stage.rows)
    assert len(flight.time) == flight.planned_samples  # no tick was lost: simulated time stood still
    assert not terminated(flight.x).any()
    before, after = read_log(stage.folder / "first.ulg"), read_log(stage.folder / "second.ulg")
    assert EARLIEST < before.time[-1] < after.time[-1]
    assert after.time[-1] == pytest.approx(SECONDS - 0.01)
    # The second one took over in its place in the reference, at most a flush after the last that was recorded.
    assert 0.0 < after.time[0] - before.time[-1] <= 0.3
    error = np.abs(flight.reference - flight.x[:, [7, 6, 5]])[flight.time > after.time[0] + 5.0]
    assert error.mean() < np.deg2rad(2.0)


def test_the_bridge_is_killed_and_started_again(stage: Stage) -> None:
    runtime, first = stage.runtime("log"), stage.bridge("first")
    wait_until(lambda: stage.flown("log.ulg") > KILLED_AT)
    os.kill(first.pid, signal.SIGKILL)
    second = stage.bridge("second")
    assert second.wait(TIMEOUT) == 0, stage.said("second")
    assert runtime.wait(TIMEOUT) == 0, stage.said("log")
    flight = read_truth(stage.folder / "second.npz", stage.rows)
    assert len(flight.time) == flight.planned_samples
    assert not terminated(flight.x).any()
    again = read_log(stage.folder / "log.2.ulg")  # a new flight, in a log of its own
    assert again.time[0] == 0.0
    assert again.time[-1] == pytest.approx(SECONDS - 0.01)


def test_a_new_flight_after_a_restart_is_as_a_first_one(stage: Stage) -> None:
    runtime, first = stage.runtime("log"), stage.bridge("first")
    wait_until(lambda: stage.flown("log.ulg") > KILLED_AT)
    os.kill(first.pid, signal.SIGKILL)
    assert stage.bridge("second").wait(TIMEOUT) == 0
    assert runtime.wait(TIMEOUT) == 0
    fresh = stage.runtime("fresh")
    assert stage.bridge("third").wait(TIMEOUT) == 0
    assert fresh.wait(TIMEOUT) == 0
    assert (stage.folder / "second.npz").read_bytes() == (stage.folder / "third.npz").read_bytes()


def test_a_bridge_left_alone_ends_with_one_line(stage: Stage) -> None:
    runtime, bridge = stage.runtime("log"), stage.bridge("truth", "--patience", "1", "--reply-timeout", "0.2")
    wait_until(lambda: stage.flown("log.ulg") > KILLED_AT)
    os.kill(runtime.pid, signal.SIGKILL)
    assert bridge.wait(TIMEOUT) == 2
    assert "no answer from 127.0.0.1" in stage.said("truth").strip().splitlines()[-1]
    flight = read_truth(stage.folder / "truth.npz", stage.rows)  # what was flown is saved
    assert flight.time[-1] > EARLIEST


def test_a_runtime_left_alone_ends_with_one_line(stage: Stage) -> None:
    runtime, bridge = stage.runtime("log"), stage.bridge("truth")
    wait_until(lambda: stage.flown("log.ulg") > KILLED_AT)
    os.kill(bridge.pid, signal.SIGKILL)
    assert runtime.wait(TIMEOUT) == 3  # after its patience of 15 s
    assert "fell silent" in stage.said("log").strip().splitlines()[-1]
    assert read_log(stage.folder / "log.ulg").time[-1] > EARLIEST
