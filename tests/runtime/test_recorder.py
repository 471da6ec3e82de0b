import fcntl
import os
import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog as Reader

from runtime.link import Severity
from runtime.presets import resolve
from runtime.recorder import Recorder, Summary, beside, check_writable, percentiles
from runtime.structured import Effectiveness
from runtime.switching import Action, Decision, Reason
from runtime.ulog import ULog
from task.errors import UserError
from task.state import STATE
from tests.runtime.rate_aircraft import MODEL, SETTINGS, Aircraft, watch


def write(path, threaded=False):
    log = ULog(path, threaded)
    log.info("name", "Understudy, ünïcode")
    log.parameter("whole", 3)
    log.parameter("part", 0.5)
    numbers = log.topic("numbers", [("double", "d"), ("float[3]", "f"), ("int16_t", "i"), ("uint8_t", "b")])
    other = log.topic("other", [("uint32_t", "u")])
    log.begin()
    for k in range(100):
        log.write(numbers, 1000 * k, 1e-12 * k, 0.5 * k, -0.5 * k, np.nan, -k, k)
        if k % 10 == 0:
            log.write(other, 1000 * k, 2**32 - 1)
            log.message(1000 * k, 4, f"line {k}")
            log.flush()
    log.close()
    return path


@pytest.mark.parametrize("threaded", [False, True])
def test_pyulog_reads_what_was_written(tmp_path, threaded):
    log = Reader(str(write(tmp_path / "a.ulg", threaded)))
    data = {topic.name: topic.data for topic in log.data_list}
    assert list(data["numbers"]["timestamp"]) == [1000 * k for k in range(100)]
    np.testing.assert_array_equal(data["numbers"]["d"], 1e-12 * np.arange(100))
    np.testing.assert_array_equal(data["numbers"]["f[1]"], -0.5 * np.arange(100))
    assert np.isnan(data["numbers"]["f[2]"]).all()
    np.testing.assert_array_equal(data["numbers"]["i"], -np.arange(100))
    assert list(data["other"]["u"]) == [2**32 - 1] * 10
    assert log.initial_parameters == {"whole": 3, "part": 0.5}
    assert log.msg_info_dict["name"] == "Understudy, ünïcode"
    assert [(m.log_level_str(), m.message) for m in log.logged_messages][3] == ("WARNING", "line 30")


def test_the_bytes_depend_on_what_is_written_alone(tmp_path):
    assert write(tmp_path / "a.ulg").read_bytes() == write(tmp_path / "b.ulg", True).read_bytes()


@pytest.mark.parametrize("cut", [0.4, 0.7, 0.9])
def test_a_log_that_was_cut_off_is_readable(tmp_path, cut):
    whole = write(tmp_path / "a.ulg").read_bytes()
    (tmp_path / "b.ulg").write_bytes(whole[: int(cut * len(whole))])
    assert len(Reader(str(tmp_path / "b.ulg")).data_list[0].data["timestamp"]) > 10


def test_a_disk_that_takes_nothing_stops_the_log_and_not_the_flight():
    log = ULog("/dev/full")
    topic = log.topic("t", [("float", "f")])
    log.begin()
    for k in range(1000):
        log.write(topic, k, 1.0)
    log.close()
    assert "the log ends here: No space left" in log.error


def test_no_number_that_a_flight_brings_makes_recording_raise(tmp_path):
    path = tmp_path / "flight.ulg"
    recorder = Recorder(path, resolve("ensemble"), "cast", ["a"], tuple(STATE)[:6], {})
    wild = np.zeros(12)
    wild[[STATE.V, STATE.h, STATE.p, STATE.q]] = 5e38, -1e300, np.nan, np.inf
    unix = 1_700_000_000_000_000  # a clock that was set to it in flight: more ticks than 32 bits hold
    recorder.cycle(unix, unix // 10_000, wild, np.zeros(3), np.zeros(3), 0.0, 1, 1 << 20)
    recorder.cycle(2**70, -3, np.zeros(12), np.zeros(3), np.zeros(3), 0.0, -1, 0)
    recorder.message(-5, 4, "x" * 70_000)
    recorder._log.close()
    log = Reader(str(path))
    cycle = log.data_list[0].data
    assert cycle["V"].tolist() == [np.inf, 0.0]
    assert cycle["h"].tolist() == [-np.inf, 0.0]
    assert np.isnan(cycle["p"][0])
    assert cycle["q"][0] == np.inf
    assert cycle["tick"].tolist() == [2**32 - 1, 0]
    assert cycle["member"].tolist() == [1, -1]
    assert cycle["health"].tolist() == [2**16 - 1, 0]
    assert cycle["timestamp"].tolist() == [unix, 2**64 - 1]
    assert len(log.logged_messages[0].message) > 60_000


def test_a_log_that_cannot_be_written_is_one_line(tmp_path):
    for path in (tmp_path, tmp_path / "file" / "f.ulg"):
        (tmp_path / "file").touch()
        with pytest.raises(UserError, match="cannot be written"):
            check_writable(path)
    check_writable(tmp_path / "new" / "f.ulg")
    check_writable(Path("/dev/null"))


def test_percentiles_of_nothing_are_nothing():
    assert percentiles(np.array([])) is None
    assert percentiles(np.arange(101.0)).p50 == 50.0


def summary():
    return Summary(
        outcome="over", seconds=1.0, wall_seconds=1.0, cycles=0, overruns=0, missed=0, skipped=0, repeated=0, gaps=0,
        plays=0, plays_skipped=0, plays_failed=0, switches=0, health={}, updates=0, updates_skipped=0, restarts=0,
        cycle_us=None, imagination_ms=None,
    )  # fmt: skip


def test_configuration_and_summary_lie_beside_the_log(tmp_path):
    path = tmp_path / "flight.ulg"
    recorder = Recorder(path, resolve("thesis"), "cast", ["a", "b"], tuple(STATE)[:10], {})
    recorder.innovation(0, np.zeros(10), 1.0)
    recorder.close(summary())
    assert beside(path, "config") == tmp_path / "flight.config.json"
    assert '"preset": "thesis"' in beside(path, "config").read_text()
    assert '"outcome": "over"' in beside(path, "summary").read_text()
    assert next(iter(Reader(str(path)).data_list)).name == "innovation"


class SlowDisk:
    """A pipe in the place of a disk: it takes 4 kB, and more only as somebody reads."""

    def __init__(self, path):
        os.mkfifo(path)
        self.path, self.reader = path, os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        fcntl.fcntl(self.reader, fcntl.F_SETPIPE_SZ, 4096)

    def read(self):
        try:
            return os.read(self.reader, 2**20)
        except BlockingIOError:
            return b""

    def read_until(self, done):
        data = b""
        while not done():
            data += self.read()
            time.sleep(0.001)
        return data + self.read()

    def close(self):
        os.close(self.reader)


@pytest.fixture
def slow_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(ULog, "WAITING", 50_000)
    disk = SlowDisk(tmp_path / "pipe")
    yield disk
    disk.close()


def fill(log, topic, first, count):
    for k in range(first, first + count):
        log.write(topic, 1000 * k, k)
        if k % 25 == 24:
            began = time.monotonic()
            log.flush()
            assert time.monotonic() - began < 0.1


def test_a_disk_that_hangs_for_a_while_costs_a_gap_that_is_counted_and_not_the_flight(slow_disk, tmp_path):
    log = ULog(slow_disk.path, threaded=True)
    topic = log.topic("t", [("uint32_t", "k")])
    log.begin()
    fill(log, topic, 0, 10_000)
    dropped = log.dropped
    assert dropped > 1000
    assert log._given - log._taken <= ULog.WAITING
    data = slow_disk.read_until(lambda: log._taken == log._given)
    fill(log, topic, 10_000, 500)
    assert not log.dropping
    assert log.dropped == dropped
    closing = threading.Thread(target=log.close)
    closing.start()
    data += slow_disk.read_until(lambda: not closing.is_alive())
    (tmp_path / "read.ulg").write_bytes(data)
    read = Reader(str(tmp_path / "read.ulg"))
    k = read.data_list[0].data["k"].astype(int)
    assert len(k) + dropped == 10_500
    assert list(k[-500:]) == list(range(10_000, 10_500))
    before_gaps = k[:-1][np.diff(k) != 1]  # a slow writer may make room for a little in between
    assert len(before_gaps) >= 1
    assert (np.diff(k) > 0).all()
    assert [d.timestamp for d in read.dropouts] == (1000 * before_gaps).tolist()
    assert not read.file_corruption
    assert log.error == f"{slow_disk.path}: {dropped} records are missing that the disk was too slow for"


def test_a_disk_that_hangs_at_the_end_is_not_waited_for_without_bound(slow_disk, monkeypatch):
    monkeypatch.setattr(ULog, "CLOSE_PATIENCE", 0.2)
    log = ULog(slow_disk.path, threaded=True)
    topic = log.topic("t", [("uint32_t", "k")])
    log.begin()
    fill(log, topic, 0, 10_000)
    began = time.monotonic()
    log.close()
    assert time.monotonic() - began < 2.0
    assert log.hangs
    assert re.search(
        r"pipe: the log ends early: the disk took nothing more for 0\.2 s; \d+ records are missing", log.error
    )
    slow_disk.read_until(lambda: not log._thread.is_alive())  # and its file is closed


def test_a_disk_that_hangs_is_said_and_its_flight_is_lost_to_the_record_alone(tmp_path, monkeypatch):
    free, well = threading.Event(), ULog._write
    monkeypatch.setattr(ULog, "_write", lambda log, block: (free.wait(5.0), well(log, block)))
    monkeypatch.setattr(ULog, "WAITING", 30_000)
    monkeypatch.setattr(ULog, "CLOSE_PATIENCE", 0.1)
    path = tmp_path / "f.ulg"
    recorder = Recorder(path, resolve("thesis"), "cast", ["a"], tuple(STATE)[:10], {}, threaded=True)
    said = []
    for k in range(1000):
        recorder.cycle(10_000 * k, k, np.zeros(12), np.zeros(3), np.zeros(3), 0.0, 0, 0)
        said += filter(None, [recorder.trouble()])
    assert said == ["the disk is too slow: the log has a gap from here on"]
    recorder.close(summary())
    assert len(recorder.lost) == 2
    assert "the log ends early" in recorder.lost[0]
    assert recorder.lost[1] == f"{beside(path, 'summary')}: not written to a disk that hangs"
    free.set()
    recorder._log._thread.join()


def test_a_spread_is_that_of_its_quantiles():
    spread = percentiles(np.arange(1001.0))
    assert (spread.count, spread.p50, spread.p99, spread.p999, spread.max) == (1001, 500.0, 990.0, 999.0, 1000.0)


def recorded(path, preset="ensemble", **of):
    return Recorder(path, resolve(preset, **of), "cast", ["a", "b"], tuple(STATE)[:6], {"link": "here"})


def test_the_log_is_handed_over_every_so_many_cycles_and_with_every_warning(tmp_path):
    recorder = recorded(tmp_path / "f.ulg", overrides=("flush_ticks=3",))
    flushed, at, flush = [], 0, recorder._log.flush
    recorder._log.flush = lambda: flushed.append(at)
    for at in range(1, 10):
        recorder.cycle(10_000 * at, at, np.zeros(12), np.zeros(3), np.zeros(3), 0.0, 0, 0)
    assert flushed == [3, 6, 9]
    flushed.clear()
    for severity in (Severity.CRITICAL, Severity.WARNING, Severity.INFO):
        at = severity
        recorder.message(0, severity, "line")
    assert flushed == [Severity.CRITICAL, Severity.WARNING]
    recorder._log.flush = flush
    recorder._log.close()


def test_every_field_of_a_cycle_and_of_a_play_holds_what_it_is_named_after(tmp_path):
    recorder = recorded(tmp_path / "f.ulg", "understudy")
    recorder.cycle(5, 7, np.arange(12.0), np.array([20.0, 21.0, 22.0]), np.array([30.0, 31.0, 32.0]), 0.5, 1, 9)
    decision = Decision(Action.SOFT, 1, Reason.DWELL, 4.5)
    recorder.play(6, np.array([-1.0, -2.0, -3.0]), 0.25, 3, decision)
    recorder.innovation(8, np.arange(6.0), 0.125)
    recorder.effectiveness(9, None, 0, 0)  # nothing identifies it
    recorder._log.close()
    log = Reader(str(tmp_path / "f.ulg"))
    topics = {topic.name: {name: values[0] for name, values in topic.data.items()} for topic in log.data_list}
    assert topics["cycle"] == {
        "timestamp": 5, **{signal.name: float(signal) for signal in STATE}, "de": 20.0, "da": 21.0, "dr": 22.0,
        "theta_ref": 30.0, "phi_ref": 31.0, "beta_ref": 32.0, "blend": 0.5, "tick": 7, "member": 1, "health": 9,
    }  # fmt: skip
    assert topics["play"] == {
        "timestamp": 6, "returns[0]": -1.0, "returns[1]": -2.0, "returns[2]": -3.0, "lead": 4.5, "age": 0.25,
        "tick_asked": 3, "member": 1, "action": 2, "reason": 8,
    }  # fmt: skip
    assert topics["innovation"] == {
        "timestamp": 8, "trace_P": 0.125, **{signal.name: float(signal) for signal in tuple(STATE)[:6]},
    }  # fmt: skip
    assert set(topics) == {"cycle", "play", "innovation"}
    assert log.initial_parameters["adaptation.preview"] == 1
    assert log.initial_parameters["operation.dt"] == pytest.approx(0.01)
    assert (log.msg_info_dict["adaptation.switch"], log.msg_info_dict["link"]) == ("soft", "here")


def test_every_field_of_what_is_known_of_the_surfaces_holds_what_it_is_named_after(tmp_path):
    recorder, found = recorded(tmp_path / "f.ulg"), Effectiveness(SETTINGS, MODEL, 1)
    aircraft = Aircraft(noise=6.3e-4)
    watch(found, aircraft, 350)
    found.alarms = 4
    found.stuck.signals, found.stuck.any = [True, False, False, False, True], True
    for at, excited in enumerate((-1, 0, 2)):
        recorder.effectiveness(at, found, excited, 5)
    recorder._log.close()
    (topic,) = Reader(str(tmp_path / "f.ulg")).data_list
    data = topic.data
    assert data["excited"].tolist() == [0, 1, 4]
    for i, surface in enumerate(("de", "da", "dr")):
        assert data[f"lambda_{surface}"][0] == pytest.approx(found.effectiveness[i])
        assert data[f"sd_{surface}"][0] == pytest.approx(found.sd[i])
        assert data[f"low_{surface}"][0] == pytest.approx(found.actuators[0, i])
        assert data[f"high_{surface}"][0] == pytest.approx(found.actuators[1, i])
        assert data[f"bias_{'pqr'[i]}"][0] == pytest.approx(found.bias[i])
    assert data["noise"][0] == pytest.approx(found.unrest.noise_variance**0.5)
    assert data["unrest"][0] == pytest.approx(max(found.unrest.levels))
    assert data["surprise"][0] == pytest.approx(found.surprise)
    names = ("alarms", "delay", "hypothesis", "stuck", "filtered")
    assert [data[name][0] for name in names] == [4, 0, 0, 17, 5]
    assert data["confidence"][0] == pytest.approx(found.evidence.confidence)
    assert data["alpha_highest"][0] == np.inf


def test_a_file_beside_the_log_that_the_disk_does_not_take_is_no_file(tmp_path):
    recorder = recorded(tmp_path / "f.ulg")
    assert recorder.lost == []
    (tmp_path / "f.summary.json").mkdir()
    recorder._write_beside("summary", {})
    (line,) = recorder.lost
    assert line.startswith(f"{tmp_path / 'f.summary.json'}: cannot be written: ")
    recorder.path = Path("/dev/null")
    recorder._write_beside("config", {})
    assert len(recorder.lost) == 1
    recorder._log.close()
