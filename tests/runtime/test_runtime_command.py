"""The command as its own process, against the bridge as its own process."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}
TIMEOUT = 60.0


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def start(tmp_path):
    """Start processes that are gone after the test; their stderr goes to a file."""
    started = []

    def start_(module, *arguments, name):
        with (tmp_path / f"{name}.err").open("w") as errors:
            process = subprocess.Popen(
                [sys.executable, "-m", module, *map(str, arguments)], stderr=errors, cwd=tmp_path, env=ENVIRONMENT
            )
        started.append(process)
        return process

    yield start_
    for process in started:
        process.kill()
        process.wait()


@pytest.fixture
def runtime(start, port, cast_folder, reference_file):
    def runtime_(*arguments, name="runtime", population=cast_folder):
        link = f"udpin:127.0.0.1:{port}"
        return start(
            "runtime", "--link", link, "--population", population, "--reference", reference_file, *arguments, name=name
        )

    return runtime_


@pytest.fixture
def bridge(start, port):
    def bridge_(*arguments, name="bridge"):
        link = f"udpout:127.0.0.1:{port}"
        return start("sim_bridge", "--link", link, "--truth", f"{name}.npz", *arguments, name=name)

    return bridge_


def said(tmp_path, name):
    return (tmp_path / f"{name}.err").read_text()


def wait_until(condition, what):
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < deadline, f"waited for {what}"
        time.sleep(0.05)


def cycle(log):
    return next(t.data for t in ULog(str(log)).data_list if t.name == "cycle")


def lines(text):
    """Return the lines that a user reads; there is never a traceback among them."""
    assert "Traceback" not in text
    return text.strip().splitlines()


def test_it_flies_the_bridge_and_leaves_the_same_log_twice(runtime, bridge, tmp_path):
    for name in ("a", "b"):
        flying = runtime("--switch", "hard", "--log", f"{name}.ulg", name=name)
        aircraft = bridge("--duration", "6", name=f"bridge-{name}")
        assert flying.wait(TIMEOUT) == 0, said(tmp_path, name)
        assert aircraft.wait(TIMEOUT) == 0
        assert "flight over after 6.0 s; 600 cycles" in said(tmp_path, name)
    assert (tmp_path / "a.ulg").read_bytes() == (tmp_path / "b.ulg").read_bytes()
    assert list(cycle(tmp_path / "a.ulg")["tick"]) == list(range(600))
    assert json.loads((tmp_path / "a.config.json").read_text())["adaptation"]["switch"] == "hard"
    assert json.loads((tmp_path / "a.summary.json").read_text())["missed"] == 0


def test_real_time_keeps_the_wall_clock(runtime, bridge, tmp_path):
    flying = runtime("--realtime", "--log", "r.ulg")
    bridge("--realtime", "--duration", "3")
    assert flying.wait(TIMEOUT) == 0, said(tmp_path, "runtime")
    summary = json.loads((tmp_path / "r.summary.json").read_text())
    assert summary["wall_seconds"] == pytest.approx(3.0, abs=1.0)
    assert summary["cycles"] > 150
    assert len(summary["real_time"]) == 2
    assert "SCHED_FIFO" in said(tmp_path, "runtime")


def test_a_bridge_killed_in_flight_and_started_again_is_a_new_flight(runtime, bridge, tmp_path):
    flying = runtime("--log", "f.ulg")
    aircraft = bridge("--duration", "36000")
    wait_until(lambda: (tmp_path / "f.ulg").exists() and (tmp_path / "f.ulg").stat().st_size > 60_000, "a flight")
    os.kill(aircraft.pid, signal.SIGKILL)
    bridge("--duration", "3", name="again")
    assert flying.wait(TIMEOUT) == 0, said(tmp_path, "runtime")
    text = said(tmp_path, "runtime")
    assert text.count("a new flight at 0.00 s") == 1
    assert len(lines(text)) < 12
    assert list(cycle(tmp_path / "f.2.ulg")["tick"]) == list(range(300))


def test_a_runtime_killed_in_flight_and_started_again_flies_on(runtime, bridge, tmp_path):
    flying = runtime("--log", "f.ulg")
    aircraft = bridge("--duration", "20")
    wait_until(lambda: (tmp_path / "f.ulg").exists() and (tmp_path / "f.ulg").stat().st_size > 60_000, "a flight")
    os.kill(flying.pid, signal.SIGKILL)
    flying.wait()
    before = (tmp_path / "f.ulg").read_bytes()
    again = runtime("--log", "f.ulg", name="again")
    assert again.wait(TIMEOUT) == 0, said(tmp_path, "again")
    assert aircraft.wait(TIMEOUT) == 0
    assert (tmp_path / "f.ulg").read_bytes() == before
    assert "flying, log in f.2.ulg" in said(tmp_path, "again")
    before, after = cycle(tmp_path / "f.ulg"), cycle(tmp_path / "f.2.ulg")
    assert after["timestamp"][0] > before["timestamp"][-1] - 20_000 > 0
    assert after["timestamp"][-1] == 19_990_000
    # It keeps its place in the reference.
    rows = np.loadtxt(next(Path(tmp_path).parent.parent.glob("**/base.csv")), delimiter=",", skiprows=1)
    np.testing.assert_allclose(after["theta_ref"], rows[after["timestamp"] // 10_000, 1], atol=1e-6)


def test_silence_in_flight_ends_with_one_line_and_the_log(runtime, bridge, tmp_path):
    flying = runtime("--log", "f.ulg", "--set", "patience=1")
    aircraft = bridge("--duration", "36000")
    wait_until(lambda: (tmp_path / "f.ulg").exists() and (tmp_path / "f.ulg").stat().st_size > 60_000, "a flight")
    os.kill(aircraft.pid, signal.SIGKILL)
    assert flying.wait(TIMEOUT) == 3
    last = lines(said(tmp_path, "runtime"))[-1]
    assert re.search(r"fell silent \(no state for 1\.\d s; what came last, 1\.\d s ago, was ODOMETRY\) after \d", last)
    assert json.loads((tmp_path / "f.summary.json").read_text())["outcome"] == "silent"
    assert len(cycle(tmp_path / "f.ulg")["tick"]) > 100


def test_silence_in_real_time_is_bridged_by_the_held_command(runtime, bridge, tmp_path):
    flying = runtime("--realtime", "--log", "f.ulg", "--set", "patience=1")
    aircraft = bridge("--realtime", "--duration", "36000")
    wait_until(lambda: (tmp_path / "f.ulg").exists() and (tmp_path / "f.ulg").stat().st_size > 30_000, "a flight")
    os.kill(aircraft.pid, signal.SIGKILL)
    assert flying.wait(TIMEOUT) == 3
    summary = json.loads((tmp_path / "f.summary.json").read_text())
    assert 80 < summary["missed"] < 400
    assert "no state came" in said(tmp_path, "runtime")


@pytest.mark.parametrize(("name", "line"), [("f.ulg", "the log ends here"), ("f.summary.json", "cannot be written")])
def test_a_record_that_the_disk_does_not_take_is_said_and_is_the_exit_code(runtime, bridge, tmp_path, name, line):
    (tmp_path / name).symlink_to("/dev/full")
    flying = runtime("--log", "f.ulg")
    bridge("--duration", "1")
    assert flying.wait(TIMEOUT) == 4
    *_, lost, last = lines(said(tmp_path, "runtime"))
    assert lost == f"runtime: {name}: {line}: No space left on device"
    assert "flight over after 1.0 s" in last
    assert last.endswith("its record is not whole, see above: f.ulg")
    assert not (tmp_path / "f.summary.json").exists()


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_flight_with_its_log(runtime, bridge, tmp_path, stop):
    flying = runtime("--log", "f.ulg")
    bridge("--duration", "36000")
    wait_until(lambda: (tmp_path / "f.ulg").exists() and (tmp_path / "f.ulg").stat().st_size > 60_000, "a flight")
    os.kill(flying.pid, stop)
    assert flying.wait(TIMEOUT) == 128 + stop
    assert f"stopped by {signal.Signals(stop).name}" in lines(said(tmp_path, "runtime"))[-1]
    assert json.loads((tmp_path / "f.summary.json").read_text())["outcome"] == "stopped"


def test_nobody_there_is_one_line(runtime, tmp_path):
    assert runtime("--set", "start_patience=0.5").wait(TIMEOUT) == 2
    assert "no state within 0.5 s: nothing came at all" in lines(said(tmp_path, "runtime"))[-1]


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("--population", "nowhere"), "nowhere"),
        (("--reference", "nowhere.csv"), "nowhere.csv: no such reference"),
        (("--set", "kapa=1"), "--set kapa: unknown key"),
        (("--config", "nowhere.toml"), "nowhere.toml: no such configuration"),
        (("--link", "tcp:1:2"), "--link tcp:1:2: expected udpin:HOST:PORT"),
        (("--log", "/proc/nowhere/f.ulg"), "--log /proc/nowhere/f.ulg: cannot be written"),
        (("--log", "/proc/f.ulg"), "--log /proc/f.ulg: cannot be written"),
    ],
)
def test_bad_input_is_one_line(runtime, tmp_path, arguments, line):
    assert runtime(*arguments).wait(TIMEOUT) == 2
    (text,) = lines(said(tmp_path, "runtime"))
    assert line in text


def test_a_port_in_use_is_one_line(runtime, port, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        assert runtime().wait(TIMEOUT) == 2
    assert lines(said(tmp_path, "runtime")) == [
        f"runtime: --link udpin:127.0.0.1:{port}: port {port} is in use; stop what uses it or choose another"
    ]


def test_a_damaged_population_is_one_line(runtime, cast_folder, tmp_path):
    for file in cast_folder.iterdir():
        if file.is_file():
            (tmp_path / "cast").mkdir(exist_ok=True)
            (tmp_path / "cast" / file.name).write_bytes(file.read_bytes())
    damaged = tmp_path / "cast" / "behaviour.onnx"
    damaged.write_bytes(damaged.read_bytes()[:-20])
    assert runtime(population=tmp_path / "cast").wait(TIMEOUT) == 2
    (line,) = lines(said(tmp_path, "runtime"))
    assert "behaviour.onnx" in line
