"""The command as a user meets it: a process, its exit code, its lines and its files."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sim_bridge.cli import bridge
from sim_bridge.link import Link, parse_address
from task.errors import UserError

ROOT = Path(__file__).parents[2]


def start(folder: Path, *options: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "sim_bridge", *options],
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
    )


def run(folder: Path, *options: str) -> tuple[int, str]:
    process = start(folder, *options)
    _, lines = process.communicate(timeout=30)
    return process.returncode, lines


def test_a_flight_leaves_truth_and_summary(tmp_path, peer_factory):
    (tmp_path / "flight.toml").write_text("duration = 0.5\nseed = 3\n[condition]\nspeed = 100.0\n")
    options = ("--flight", "flight.toml", "--truth", "out/truth.npz", "--link", peer_factory().link)
    code, lines = run(tmp_path, *options)
    assert code == 0, lines
    assert "50 ticks" in lines
    with np.load(tmp_path / "out" / "truth.npz") as truth:
        assert truth["x"].shape == (51, 12)
        assert truth["x"][0, 3] == pytest.approx(100.0)
    summary = json.loads((tmp_path / "out" / "truth.bridge.json").read_text())
    assert (summary["outcome"], summary["seed"], summary["link"]["late"]) == ("complete", 3, 0)
    assert summary["response_us"]["p50"] > 0


def test_the_command_line_overrides_seed_and_duration(tmp_path, peer_factory):
    code, lines = run(tmp_path, "--seed", "9", "--duration", "0.2", "--link", peer_factory().link)
    assert code == 0, lines
    summary = json.loads((tmp_path / "truth.bridge.json").read_text())
    assert (summary["seed"], summary["ticks"]) == (9, 20)


@pytest.mark.parametrize(
    ("number", "timing"),
    [
        (signal.SIGTERM, ("--realtime", "--duration", "30")),
        (signal.SIGINT, ("--realtime", "--duration", "30")),
        (signal.SIGTERM, ("--duration", "3600")),  # lockstep with a peer that never makes it wait
    ],
)
def test_a_signal_ends_the_flight_with_everything_saved(tmp_path, peer_factory, number, timing):
    peer = peer_factory()
    process = start(tmp_path, *timing, "--link", peer.link)
    deadline = time.monotonic() + 20
    while len(peer.times) < 20 and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(number)
    _, lines = process.communicate(timeout=10)
    assert process.returncode == 128 + number
    assert f"by {number.name}" in lines
    with np.load(tmp_path / "truth.npz") as truth:
        assert 10 < len(truth["command"]) < 300_000
    assert json.loads((tmp_path / "truth.bridge.json").read_text())["outcome"] == "stopped"
    time.sleep(0.05)
    assert peer.statuses[-1] == 7


def test_a_signal_is_heard_while_nobody_answers(tmp_path):
    process = start(tmp_path, "--link", "udpout:127.0.0.1:9", "--patience", "60")
    time.sleep(1.5)
    process.send_signal(signal.SIGTERM)
    began = time.monotonic()
    process.communicate(timeout=10)
    assert time.monotonic() - began < 2.0
    assert process.returncode == 128 + signal.SIGTERM


def test_no_runtime_is_one_line_and_exit_code_2(tmp_path):
    code, lines = run(tmp_path, "--link", "udpout:127.0.0.1:9", "--patience", "0.2")
    assert code == 2
    assert len(lines.splitlines()) == 1
    assert "no answer from 127.0.0.1:9" in lines
    assert (tmp_path / "truth.npz").exists()


@pytest.mark.parametrize(
    ("options", "text", "line"),
    [
        (("--flight", "none.toml"), None, "none.toml: no such flight"),
        (("--flight", "f.toml"), "wibble = 1", "f.toml: object contains unknown field `wibble`"),
        (("--flight", "f.toml"), "duration = -1.0", "f.toml: expected `float` >= 0.01"),
        (("--flight", "f.toml"), "[condition]\nspeed = 20.0", "cannot be trimmed"),
        (("--flight", "f.toml"), "duration = [", "f.toml: not valid TOML"),
        (("--link", "udpin:0.0.0.0:14560"), None, "expected udpout:HOST:PORT"),
        (("--link", "udpout:127.0.0.1:0"), None, "expected a port from 1 to 65535"),
        (("--link", "udpout:no.such.host.invalid:1"), None, "cannot reach no.such.host.invalid"),
        (("--link", "udpout:ü..x:1"), None, "cannot reach ü..x: it is no name of a host"),
        (("--truth", "."), None, "expected a file"),
        (("--truth", "x", "--summary", "./x"), None, "--summary x: is --truth's file too"),
        (("--flight", "f.toml", "--truth", "f.toml"), "seed = 1", "--truth f.toml: is --flight's file too"),
        (
            ("--flight", "f.toml"),
            "[condition]\nspeed = 0.0",
            "f.toml: expected `float` >= 10.0 [m/s], got 0.0 - at `$.condition.speed`",
        ),
        (("--flight", "f.toml"), "[condition]\nspeed = nan", "f.toml: expected `float` >= 10.0"),
        (("--flight", "f.toml"), "[condition]\naltitude = 20.0", "f.toml: expected `float` >= 50.0"),
        (("--flight", "f.toml"), "[condition]\naltitude = inf", "f.toml: expected `float` <= 20000.0"),
        (("--flight", "f.toml"), "[condition]\nflight_path = -3", "f.toml: expected `float` >= -1.57"),
        (("--flight", "f.toml"), "[condition]\nheading = 270", "f.toml: expected `float` <= 6.28"),
        (
            ("--flight", "f.toml"),
            "[air]\nwind_north = 1e6",
            "f.toml: expected `float` <= 100.0 [m/s], got 1000000.0 - at `$.air.wind_north`",
        ),
        (("--flight", "f.toml"), "[air]\nwind_east = nan", "f.toml: expected `float` >= -100.0"),
        (("--flight", "f.toml"), "[sensors.bias]\nq = nan", "bias.q: expected at most 5 rad/s either way, got nan"),
        (("--flight", "f.toml"), "[sensors.noise]\ntheta = inf", "noise.theta: expected at most 3.15 rad"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, options, text, line):
    if text is not None:
        (tmp_path / "f.toml").write_text(text)
    code, lines = run(tmp_path, *options)
    assert code == 2
    assert line in lines
    assert len(lines.splitlines()) == 1, lines


@pytest.mark.parametrize(
    "options",
    [
        ("--duration", "nan"), ("--duration", "0.001"), ("--duration", "86400"), ("--patience", "nan"),
        ("--reply-timeout", "nan"), ("--patience", "0"),
    ],
)  # fmt: skip
def test_times_that_make_no_sense_are_refused(options):
    ended = CliRunner().invoke(bridge, options)
    assert ended.exit_code == 2
    assert f"Invalid value for '{options[0]}'" in ended.output


def test_truth_and_flight_log_of_one_name_keep_both_summaries(tmp_path, peer_factory):
    (tmp_path / "mm.summary.json").write_text("the runtime's")
    code, lines = run(tmp_path, "--truth", "mm.npz", "--duration", "0.1", "--link", peer_factory().link)
    assert code == 0, lines
    assert (tmp_path / "mm.summary.json").read_text() == "the runtime's"
    assert json.loads((tmp_path / "mm.bridge.json").read_text())["ticks"] == 10


def test_a_fault_after_the_end_is_said(tmp_path, peer_factory):
    (tmp_path / "f.toml").write_text("[[faults]]\nkind = 'yaw_damper_off'\nstart = 20.0\n")
    code, lines = run(tmp_path, "--flight", "f.toml", "--duration", "0.1", "--link", peer_factory().link)
    assert code == 0
    assert "faults[0].start: expected less than the flight's duration of 0.1 s, got 20 s (yaw damper off)" in lines


@pytest.mark.parametrize("link", ["", "udpout", "udpout:127.0.0.1", "udpout::14560", "tcp:1.2.3.4:5", "udpout:a:70000"])
def test_an_address_that_makes_no_sense_is_refused(link):
    with pytest.raises(UserError, match="--link"):
        parse_address(link)


@pytest.mark.parametrize("option", ["--duration", "--patience", "--reply-timeout"])
def test_a_time_that_is_no_number_is_refused(tmp_path, option):
    code, lines = run(tmp_path, option, "nan")
    assert code == 2
    assert "expected a number of seconds, got nan" in lines


def test_a_closed_port_is_noticed_and_does_not_raise():
    with Link("udpout:127.0.0.1:9") as link:
        for _ in range(3):
            link.send(b"hello")
            assert link.receive(time.perf_counter() + 0.05) is None
        assert link.refused
