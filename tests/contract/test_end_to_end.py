"""Whole flights: the runner, the bridge and the runtime, each in its own process, with MAVLink between."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v10 import common as mavlink1
from pymavlink.dialects.v20 import common as mavlink2

from scenarios.references import build
from scenarios.run import Job, fly, fly_all, plan
from scenarios.schema import MODES, Scenario
from scenarios.trace import read_log
from sim_bridge.air import Air
from sim_bridge.faults import CGShift
from sim_bridge.flight import Flight
from sim_bridge.sensors import SensorSettings
from task.errors import UserError
from task.state import REFERENCE, TRACKED

SECONDS = 8.0
TIMEOUT = 90.0
MODE_NAMES = ("none", "thesis-hard", "understudy-soft")
Damage = Callable[[str, Callable[[bytes], bytes]], Path]


FAULT_AT = 4.0
FAULT = CGShift(aft=0.25, start=FAULT_AT)
NOISE = SensorSettings(noise={"p": 6.3e-4, "q": 6.3e-4, "r": 6.3e-4}, bias={"theta": 4e-3})


def jobs(cast: Path, out: Path, seconds: float = SECONDS, **flight: object) -> list[Job]:
    scenario = Scenario(title="t", flight=Flight(duration=seconds, **({"faults": (FAULT,)} | flight)))
    return plan(scenario.flight, build(scenario, out), [MODES[name] for name in MODE_NAMES], cast, out)


@pytest.fixture(scope="module")
def flown(flying_cast: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of three flights, flown two at once."""
    out = tmp_path_factory.mktemp("flown")
    fly_all(jobs(flying_cast, out), at_once=2)
    return out


def test_every_mode_flies_to_the_end_and_follows(flying_cast: Path, flown: Path) -> None:
    for job in jobs(flying_cast, flown):
        result = fly(job)
        assert result.reused  # from the same inputs: not flown again
        assert result.score.survived
        assert result.score.late_ticks == 0
        assert len(result.flight.time) == round(SECONDS * 100)
        error = result.flight.reference - result.flight.x[:, TRACKED]
        assert np.abs(error[:, REFERENCE.phi]).mean() < np.deg2rad(3.0)
        assert 0.0 < result.score.nmae < 40.0
        assert result.flight.fault_at == pytest.approx(FAULT_AT)
        assert result.score.nmae_before is not None
        assert result.score.nmae_after is not None
        np.testing.assert_array_equal(result.adaptation.time, result.flight.time)
        at_fault = result.adaptation.time == FAULT_AT + 0.02
        quiet = (result.adaptation.time > 3.0) & (result.adaptation.time < FAULT_AT)
        surprise = np.abs(result.adaptation.innovation[:, result.adaptation.innovation_names.index("q")])
        assert surprise[at_fault] > 10.0 * surprise[quiet].max()  # the model did not foresee the fault


def test_a_better_member_takes_over_where_the_runtime_may(flying_cast: Path, flown: Path) -> None:
    none, _, soft = (fly(job) for job in jobs(flying_cast, flown))
    assert none.score.switches == 0
    assert none.adaptation.plays == []
    assert soft.score.switches >= 1
    assert soft.adaptation.members[soft.adaptation.active[-1]] != "lazy"
    assert soft.score.nmae < none.score.nmae


def test_the_same_flight_twice_is_the_same_bit_for_bit(flying_cast: Path, flown: Path, tmp_path: Path) -> None:
    again = jobs(flying_cast, tmp_path)
    fly_all(again, at_once=1)
    for first, second in zip(jobs(flying_cast, flown), again, strict=True):
        for name in ("flight.ulg", "truth.npz", "reference.csv", "flight.toml"):
            assert (first.folder / name).read_bytes() == (second.folder / name).read_bytes(), (first.name, name)


def test_noise_and_turbulence_are_the_same_for_the_same_seed(flying_cast: Path, tmp_path: Path) -> None:
    rough = {"sensors": NOISE, "air": Air(turbulence="light")}
    first, second, other = (
        jobs(flying_cast, tmp_path / name, 4.0, seed=seed, **rough)[-1]
        for name, seed in (("first", 5), ("second", 5), ("other", 6))
    )
    fly_all([first, second, other])
    for name in ("flight.ulg", "truth.npz"):
        assert (first.folder / name).read_bytes() == (second.folder / name).read_bytes()
        assert (first.folder / name).read_bytes() != (other.folder / name).read_bytes()


def test_other_inputs_are_flown_anew_and_fresh_means_fresh(flying_cast: Path, flown: Path) -> None:
    (job, *_) = jobs(flying_cast, flown)
    assert fly(job).reused
    assert not fly(job, fresh=True).reused
    (shorter, *_) = jobs(flying_cast, flown, seconds=2.0)
    result = fly(shorter)
    assert not result.reused
    assert len(result.flight.time) == 200


def test_a_flight_that_fails_stops_the_others_and_leaves_nothing_running(flying_cast: Path, tmp_path: Path) -> None:
    good = jobs(flying_cast, tmp_path, seconds=600.0)
    bad = plan(good[0].flight, [good[0].reference], [MODES["none"]], tmp_path / "gone", tmp_path / "bad")
    (tmp_path / "gone").mkdir()
    (tmp_path / "gone" / "manifest.json").write_text("{}")
    began = time.monotonic()
    with pytest.raises(UserError, match=r"none, base: runtime: .*manifest\.json") as caught:
        fly_all([*good, *bad], at_once=4)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - began < 60.0
    assert not flying_on(tmp_path)


def flying_on(folder: Path) -> list[str]:
    """Return the command lines of processes that mention a folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
            if str(folder) in line and " -m " in line:
                found.append(line)
    return found


def understudy(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "understudy", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def run(folder: Path, *arguments: str) -> tuple[int, str, str]:
    process = understudy(folder, *arguments)
    out, error = process.communicate(timeout=TIMEOUT)
    return process.returncode, out, error


SCENARIO = 'title = "Short"\nmodes = ["none", "understudy-soft"]\n[flight]\nduration = {seconds}\n'


def test_the_command_leaves_table_and_report(flying_cast: Path, tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SCENARIO.format(seconds=4.0))
    code, out, error = run(
        tmp_path, "fly", "short.toml", "--population", str(flying_cast), "--references", "2", "--jobs", "2"
    )
    assert code == 0, error
    assert error == ""
    assert "4 flights in" in out
    table = out[out.index("nMAE %  worst %") :]  # the heading of the table
    assert [line.split()[1] for line in table.splitlines() if "●" in line] == ["none", "understudy-soft"]
    page = (tmp_path / "flights" / "short" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert "evaluation-2" in page


def test_ctrl_c_ends_everything_with_one_line(flying_cast: Path, tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text(SCENARIO.format(seconds=600.0))
    out = tmp_path / "out"
    process = understudy(tmp_path, "fly", "long.toml", "--population", str(flying_cast), "--out", str(out))
    deadline = time.monotonic() + TIMEOUT
    while not list(out.rglob("flight.ulg")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=30.0)
    assert process.returncode == 130
    assert error == f"understudy: stopped; what was flown is kept in {out}\n"
    assert not flying_on(out)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["nowhere"], "understudy: scenario 'nowhere': no such scenario; choose one of "),
        (["nowhere.toml"], "understudy: nowhere.toml: no such scenario; check the path"),
        (["typo.toml"], "understudy: typo.toml: object contains unknown field `lenght` - at `$.flight`; known keys: "),
        (["fault.toml"], "understudy: fault.toml: "),
        (["short.toml", "--modes", "none,magic"], "understudy: --modes none,magic: unknown mode 'magic'; choose from "),
        (["short.toml", "--population", "nowhere"], "understudy: population 'nowhere': no such population; expected "),
        (["high.toml", "--population", "CAST"], "understudy: flight condition altitude "),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    flying_cast: Path, tmp_path: Path, arguments: list[str], line: str
) -> None:
    (tmp_path / "short.toml").write_text(SCENARIO.format(seconds=1.0))
    (tmp_path / "typo.toml").write_text('title = "t"\n[flight]\nlenght = 3.0\n')
    (tmp_path / "fault.toml").write_text('title = "t"\n[[flight.faults]]\nkind = "meteor"\n')
    (tmp_path / "high.toml").write_text('title = "t"\n[flight.condition]\naltitude = 19000.0\nspeed = 20.0\n')
    code, _, error = run(tmp_path, "fly", *(str(flying_cast) if a == "CAST" else a for a in arguments))
    assert code == 2
    assert error.startswith(line), error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("file", "change", "line"),
    [
        ("behaviour.onnx", lambda data: data[:-20], "behaviour.onnx"),
        ("imagination.onnx", lambda data: data[:100] + b"\0" + data[101:], "imagination.onnx"),
        ("manifest.json", lambda data: data[: len(data) // 2], "manifest.json: not valid JSON"),
        ("manifest.json", lambda data: data.replace(b'"command_lag"', b'"comand_lag"'), "comand_lag"),
        ("parameters.npy", lambda data: data[:-1] + b"\x7f", "parameters.npy"),
    ],
)
def test_a_damaged_population_is_one_line(
    damaged_cast: Damage, tmp_path: Path, file: str, change: Callable[[bytes], bytes], line: str
) -> None:
    (tmp_path / "short.toml").write_text(SCENARIO.format(seconds=1.0))
    code, _, error = run(tmp_path, "fly", "short.toml", "--population", str(damaged_cast(file, change)))
    assert code == 2
    # two flights begin side by side; which of them says it first is chance
    assert re.match(r"understudy: [a-z-]+, base: runtime: ", error), error
    assert line in error
    assert error.count("\n") == 1


@pytest.fixture
def runtime(flying_cast: Path, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Return a runtime process that waits for an aircraft, and its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "runtime", "--link", f"udpin:127.0.0.1:{port}", "--population", str(flying_cast)),
            *("--log", str(tmp_path / "f.ulg"), "--set", "start_patience=6", "--set", "patience=1"),
        ],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    yield process, port
    process.kill()
    process.communicate()


def feed(process: subprocess.Popen[str], port: int, frames: list[bytes], seconds: float = TIMEOUT) -> tuple[int, str]:
    """Send frames again and again until the process ends; return its exit code and last line."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        deadline = time.monotonic() + seconds
        while process.poll() is None:
            assert time.monotonic() < deadline
            for frame in frames:
                link.sendto(frame, ("127.0.0.1", port))
            time.sleep(0.05)
    assert process.stderr is not None
    lines = process.stderr.read().strip().splitlines()
    assert not any("Traceback" in line for line in lines)
    return process.returncode, lines[-1]


def test_the_wrong_dialect_is_named(runtime: tuple[subprocess.Popen[str], int]) -> None:
    sender = mavlink1.MAVLink(None, srcSystem=1, srcComponent=200)
    beat = mavlink1.MAVLink_heartbeat_message(1, 8, 32, 1, 3, 3).pack(sender)
    assert beat[0] == 0xFE  # a MAVLink 1 frame
    code, line = feed(*runtime, [beat])
    assert code == 2
    assert "MAVLink 1" in line


def odometry(time_usec: int, first_rate: float) -> list[bytes]:
    """Return origin and state of the aircraft in trim."""
    sender = mavlink2.MAVLink(None, srcSystem=1, srcComponent=200)
    covariance = [float("nan")] + [0.0] * 20
    origin = mavlink2.MAVLink_gps_global_origin_message(0, 0, 2_000_000, time_usec)
    state = mavlink2.MAVLink_odometry_message(
        time_usec, 1, 12, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 89.8, 0.0, 5.0, first_rate, 0.0, 0.0,
        covariance, covariance, 7, 8, 100,
    )  # fmt: skip
    return [origin.pack(sender), state.pack(sender)]


def test_a_state_that_is_not_a_number_is_named(runtime: tuple[subprocess.Popen[str], int]) -> None:
    code, line = feed(*runtime, odometry(0, float("nan")))
    assert code == 2
    assert "not finite" in line


def test_a_port_in_use_is_one_line(flying_cast: Path, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        link = f"udpin:127.0.0.1:{port}"
        code, _, error = run(tmp_path, "runtime", "--link", link, "--population", str(flying_cast))
    assert code == 2
    assert error.count("\n") == 1
    assert f"port {port} is in use" in error


def test_the_runner_says_when_nothing_was_flown(flying_cast: Path, tmp_path: Path) -> None:
    (job, *_) = jobs(flying_cast, tmp_path, seconds=1.0)
    fly(job)
    (job.folder / "flight.ulg").write_bytes(b"no log")
    with pytest.raises(UserError, match=r"flight\.ulg: not a flight log of the runtime"):
        fly(job)
    (job.folder / "flight.ulg").unlink()
    with pytest.raises(UserError, match="no flight log"):
        read_log(job.folder / "flight.ulg")
    summary = json.loads((job.folder / "truth.summary.json").read_text())
    assert summary["outcome"] == "complete"
