"""Whole flights on the plant, in process: the runtime's own parts, no sockets."""

import gc
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest
from pyulog import ULog

from runtime.cli import _leave
from runtime.clock import SteppedClock
from runtime.identification import IncrementalModel
from runtime.link import Sample
from runtime.loop import Outcome
from runtime.population import load_population
from runtime.presets import resolve
from runtime.recorder import Recorder
from runtime.reference import LiveReference, RecordedReference
from runtime.session import Session, free_log, log_path
from sim_bridge.plant import Plant
from task.errors import UserError
from task.limits import DEFLECTION_LIMIT
from task.reference import base_reference
from task.state import STATE

ROWS = base_reference(20.0, 0.056)


@pytest.fixture(scope="session")
def cast(cast_folder):
    return load_population(cast_folder)


def fly(link, cast, log, preset="understudy", overrides=(), switch=None, reference=None, **options):
    configuration = resolve(preset, None, overrides, switch)
    with Session(link, cast, reference or RecordedReference(ROWS), configuration, log, **options) as session:
        return session.fly()


def topics(log):
    return {topic.name: topic.data for topic in ULog(str(log)).data_list}


def weak_elevator(tick, action):
    return action * np.array([0.25 if tick >= 300 else 1.0, 1.0, 1.0])


def test_the_champion_flies_the_whole_reference(cast, plant_link, tmp_path):
    link = plant_link(2000)
    (flown,) = fly(link, cast, tmp_path / "f.ulg", switch="none")
    assert flown.outcome is Outcome.OVER
    assert flown.summary.cycles == 2000
    assert flown.summary.plays == 0
    assert np.degrees(link.error(ROWS)).max() < 2.5


@pytest.mark.parametrize("switch", ["hard", "soft"])
def test_a_weak_elevator_is_answered_with_a_stronger_member(cast, plant_link, tmp_path, switch):
    alone = plant_link(2000, weak_elevator)
    fly(alone, cast, tmp_path / "none.ulg", switch="none")
    link = plant_link(2000, weak_elevator)
    (flown,) = fly(link, cast, tmp_path / "f.ulg", switch=switch)
    assert flown.summary.switches >= 1
    assert link.error(ROWS)[0] < 0.8 * alone.error(ROWS)[0]
    cycle = topics(tmp_path / "f.ulg")["cycle"]
    assert cycle["member"][-1] == cast.members.index("strong")
    assert (cycle["blend"].max() > 0.0) == (switch == "soft")


@pytest.mark.parametrize("preset", ["thesis", "understudy"])
def test_two_flights_leave_the_same_bits(cast, plant_link, tmp_path, preset):
    logs = []
    for name in ("a", "b"):
        fly(plant_link(700, weak_elevator), cast, tmp_path / f"{name}.ulg", preset)
        logs.append((tmp_path / f"{name}.ulg").read_bytes())
    assert logs[0] == logs[1]


def test_the_log_says_what_was_seen_decided_and_done(cast, plant_link, tmp_path):
    link = plant_link(1000)
    fly(link, cast, tmp_path / "f.ulg", overrides=("kappa=0.999",), information={"link": "here"})
    log = ULog(str(tmp_path / "f.ulg"))
    data = {topic.name: topic.data for topic in log.data_list}
    cycle = data["cycle"]
    assert list(cycle["tick"]) == list(range(1000))
    assert list(cycle["timestamp"]) == [10_000 * k for k in range(1000)]
    truth = np.array(link.x[:1000])
    for signal_ in STATE:
        np.testing.assert_allclose(cycle[signal_.name], truth[:, signal_], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.column_stack([cycle[n] for n in ("de", "da", "dr")]), link.sent, atol=1e-7)
    np.testing.assert_allclose(cycle["theta_ref"], ROWS[:1000, 0], atol=1e-6)
    assert set(data["innovation"]) == {"timestamp", "trace_P", "p", "q", "r", "V", "alpha", "beta"}
    play = data["play"]
    assert list(play["tick_asked"]) == [200, 400, 600, 800]
    np.testing.assert_allclose(play["age"], 0.1, atol=1e-6)
    assert {f"returns[{i}]" for i in range(len(cast.members) + 1)} <= set(play)
    assert log.initial_parameters["adaptation.kappa"] == pytest.approx(0.999)
    assert msgspec.json.decode(log.msg_info_dict["members"]) == list(cast.members)
    assert log.msg_info_dict["link"] == "here"
    assert any("flight ends: over" in m.message for m in log.logged_messages)
    configuration = json.loads((tmp_path / "f.config.json").read_text())
    assert configuration["adaptation"]["kappa"] == 0.999
    summary = json.loads((tmp_path / "f.summary.json").read_text())
    assert summary["outcome"] == "over"
    assert summary["cycle_us"]["count"] == 1000


@pytest.mark.parametrize(
    ("ticks", "value", "flag"),
    [(range(400, 430), np.nan, "state_not_finite"), (range(400, 401), 1e5, "state_implausible")],
)
def test_a_state_that_cannot_be_used_is_held_over_and_said(cast, plant_link, tmp_path, ticks, value, flag):
    def spoil(tick, x):
        if tick in ticks:
            x[STATE.q] = value
        return x

    link = plant_link(1000, state=spoil)
    (flown,) = fly(link, cast, tmp_path / "f.ulg")
    assert flown.outcome is Outcome.OVER
    assert flown.summary.health[flag] == len(ticks)
    sent = np.array(link.sent)
    assert np.isfinite(sent).all()
    np.testing.assert_array_equal(sent[ticks[0] : ticks[-1] + 1], np.tile(sent[ticks[0] - 1], (len(ticks), 1)))
    assert len(link.lines) < 5
    assert link.error(ROWS)[0] < np.radians(3.0)


def test_the_first_state_is_waited_for_until_it_can_be_used(cast, plant_link, tmp_path):
    asked = []

    def blind(tick, x):
        asked.append(tick)
        return x * np.nan if len(asked) < 5 else x

    lines = []
    (flown,) = fly(plant_link(20, state=blind), cast, tmp_path / "f.ulg", say=lines.append)
    assert flown.summary.cycles == 20
    assert any("not flying yet: the state is not finite" in line for line in lines)


def test_states_that_never_can_be_used_are_one_line(cast, plant_link, tmp_path):
    link = plant_link(20, state=lambda tick, x: x * np.nan)
    with pytest.raises(UserError, match=r"no state within 0\.1 s: states came, but the state is not finite"):
        fly(link, cast, tmp_path / "f.ulg", overrides=("start_patience=0.1",))


def test_a_lost_aircraft_ends_the_flight_with_its_log(cast, plant_link, tmp_path):
    link = plant_link(2000, lambda tick, action: action * np.array([-1.0 if tick >= 100 else 1.0, 1.0, 1.0]))
    (flown,) = fly(link, cast, tmp_path / "f.ulg", switch="none")
    assert flown.outcome is Outcome.LOST
    assert len(topics(tmp_path / "f.ulg")["cycle"]["tick"]) == flown.summary.cycles < 2000


class TwoFlights:
    """A link whose other side starts again: another flight, or time that goes back."""

    def __init__(self, plant_link, flight):
        self.make, self.flight = plant_link, flight
        self.now, self.rest = plant_link(300), [plant_link(200)]
        self.ended, self.skipped, self.repeated = "", 0, 0
        self.commands = [[]]

    def read(self, timeout):
        sample = self.now.read(timeout)
        if sample is None and self.rest:
            self.now = self.rest.pop()
            self.commands.append([])
            sample = self.now.read(timeout)
        if sample is None:
            self.ended = self.now.ended
            return None
        return Sample(sample.time_usec, self.flight if len(self.commands) > 1 else 1, sample.x)

    def write(self, action, time_usec):
        self.commands[-1].append(np.array(action))
        self.now.write(action, time_usec)

    def say(self, text, severity):
        pass

    def diagnosis(self):
        return ""

    def close(self):
        pass


@pytest.mark.parametrize("flight", [1, 2])
def test_the_other_side_starts_again_and_so_do_we(cast, plant_link, tmp_path, flight):
    link, lines = TwoFlights(plant_link, flight), []
    first, second = fly(link, cast, tmp_path / "f.ulg", say=lines.append)
    assert (first.outcome, second.outcome) == (Outcome.REPLACED, Outcome.OVER)
    assert (first.summary.cycles, second.summary.cycles) == (300, 200)
    assert second.log == log_path(tmp_path / "f.ulg", 2) == tmp_path / "f.2.ulg"
    assert len([line for line in lines if "a new flight" in line]) == 1
    # Nothing of the first flight is left: the second is flown as if it were alone.
    np.testing.assert_array_equal(link.commands[0][:200], link.commands[1])
    assert second.summary.updates == 200 - 3


class BrokenError(Exception):
    """What no link should raise."""


@pytest.mark.parametrize("where", ["read", "write"])
@pytest.mark.parametrize("error", [OSError(100, "Network is down"), BrokenError("of it"), KeyboardInterrupt()])
def test_a_link_that_fails_leaves_a_whole_record(cast, plant_link, tmp_path, where, error):
    class Failing(plant_link):
        def read(self, timeout):
            if self.tick == 318 and where == "read":
                raise error
            return super().read(timeout)

        def write(self, action, time_usec):
            if self.tick == 318 and where == "write":
                raise error
            super().write(action, time_usec)

    log, lines = tmp_path / "f.ulg", []
    if isinstance(error, OSError):
        (flown,) = fly(Failing(600), cast, log, say=lines.append)
        assert (flown.outcome, flown.failure) == (Outcome.FAILED, "OSError: [Errno 100] Network is down")
        assert flown.lost == ()
    else:
        with pytest.raises(type(error)):
            fly(Failing(600), cast, log, say=lines.append)
    assert len(topics(log)["cycle"]["tick"]) == 318
    messages = [m.message for m in ULog(str(log)).logged_messages]
    assert messages[-1] == "flight ends: failed"
    assert any("the link failed: OSError" in m for m in messages) == isinstance(error, OSError)
    summary = json.loads((tmp_path / "f.summary.json").read_text())
    assert (summary["outcome"], summary["cycles"]) == ("failed", 318)


def test_a_link_that_fails_before_the_first_state_is_one_line(cast, plant_link, tmp_path):
    link = plant_link(10)

    def fails(timeout):
        raise OSError(100, "Network is down")

    link.read = fails
    with pytest.raises(UserError, match=r"the link failed before any state .*: OSError: \[Errno 100\] Network is down"):
        fly(link, cast, tmp_path / "f.ulg")


def test_a_link_that_failed_is_said_and_left_with_the_code_of_silence(cast, plant_link, tmp_path, capsys):
    class Failing(plant_link):
        def read(self, timeout):
            if self.tick == 50:
                raise OSError(100, "Network is down")
            return super().read(timeout)

    link = Failing(100)
    link.silence = lambda: ""
    flown = fly(link, cast, tmp_path / "f.ulg")
    with pytest.raises(SystemExit) as left:
        _leave(flown, link, 0)
    assert left.value.code == 3
    said = capsys.readouterr().err
    assert said.startswith("runtime: the link failed (OSError: [Errno 100] Network is down) after 0.5 s; 50 cycles")
    assert said.count("\n") == 1


@pytest.mark.parametrize(("since", "told"), [("zero", 1), ("first_state", 0)])
def test_a_clock_that_starts_after_the_references_end_is_told_so(cast, plant_link, tmp_path, since, told):
    epoch, lines = 1_700_000_000_000_000, []

    class Unix(plant_link):
        def read(self, timeout):
            sample = super().read(timeout)
            return sample and sample._replace(time_usec=sample.time_usec + epoch)

        def write(self, action, time_usec):
            super().write(action, time_usec - epoch)

    fly(Unix(10), cast, tmp_path / "f.ulg", overrides=(f"reference_from={since}",), say=lines.append)
    assert len([line for line in lines if "the reference ended at 19.99 s: its last row is held" in line]) == told


def test_a_population_flies_with_its_own_sample_time_alone(cast, plant_link, tmp_path):
    with pytest.raises(UserError, match=r"dt: population .* flies with 0.01 s, got 0.02 s"):
        fly(plant_link(10), cast, tmp_path / "f.ulg", overrides=("dt=0.02",))


def test_a_start_keeps_the_logs_that_are_there(cast, plant_link, tmp_path):
    log, lines = tmp_path / "f.ulg", []
    (first,) = fly(plant_link(100), cast, log)
    kept = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(kept) == 3
    (second,) = fly(plant_link(50), cast, log, say=lines.append)
    assert (first.log, second.log) == (log, tmp_path / "f.2.ulg")
    assert lines[0].endswith(f"flying, log in {second.log}")
    assert {path: path.read_bytes() for path in kept} == kept
    assert len(topics(second.log)["cycle"]["tick"]) == 50
    (again,) = fly(plant_link(60), cast, log, overwrite=True)
    assert again.log == log
    assert len(topics(log)["cycle"]["tick"]) == 60
    log.unlink()  # its summary is still there
    third, fourth = fly(TwoFlights(plant_link, 2), cast, log)
    assert (third.log, fourth.log) == (tmp_path / "f.3.ulg", tmp_path / "f.4.ulg")


def test_a_free_log_is_found_whatever_its_name(tmp_path):
    for name, second in (("f.ulg", "f.2.ulg"), ("f.a.ulg", "f.a.2.ulg"), ("log", "log-2")):
        assert free_log(tmp_path / name) == tmp_path / name
        (tmp_path / name).touch()
        assert free_log(tmp_path / name) == tmp_path / second
        (tmp_path / name).with_suffix(".summary.json").touch()
        assert free_log(tmp_path / name) == tmp_path / second
    assert free_log(Path("/dev/null")) == Path("/dev/null")


def test_a_gap_restarts_the_increments_and_not_the_model(cast, plant_link, tmp_path):
    class Gap(plant_link):
        def read(self, timeout):
            if self.tick == 300:
                for _ in range(5):
                    super().write(self.sent[-1], self.tick * 10_000)
            return super().read(timeout)

    (flown,) = fly(Gap(600), cast, tmp_path / "f.ulg")
    assert flown.summary.gaps == 1
    assert flown.summary.health["gap"] == 1
    assert flown.summary.updates == 595 - 3 - 2  # the commands through the gap are known: the last one was held
    ticks = list(topics(tmp_path / "f.ulg")["cycle"]["tick"])
    assert ticks == [*range(300), *range(305, 600)]


def test_a_clock_that_jitters_leaves_no_gap(cast, plant_link, tmp_path):
    class Jitter(plant_link):
        def read(self, timeout):
            sample = super().read(timeout)
            return sample and sample._replace(time_usec=sample.time_usec + (-1) ** self.tick * 2_000)

        def write(self, action, time_usec):
            super().write(action, self.tick * 10_000)

    (flown,) = fly(Jitter(300), cast, tmp_path / "f.ulg")
    assert flown.summary.gaps == 0


@pytest.mark.parametrize("where", ["observe", "command"])
def test_a_defect_of_the_runtime_leaves_the_aircraft_a_command(cast, plant_link, tmp_path, monkeypatch, where):
    link, lines, well = plant_link(600), [], getattr(IncrementalModel, where)

    def fails(model, given):
        if 300 <= link.tick < 305:
            raise OverflowError("too large")
        return well(model, given)

    monkeypatch.setattr(IncrementalModel, where, fails)
    (flown,) = fly(link, cast, tmp_path / "f.ulg", say=lines.append)
    assert flown.outcome is Outcome.OVER
    assert flown.summary.health["defect"] == 5
    assert len(link.sent) == 600
    assert np.abs(link.sent).max() <= DEFLECTION_LIMIT
    assert len([line for line in lines if "the runtime failed: OverflowError: too large" in line]) == 1
    if where == "observe":
        np.testing.assert_array_equal(link.sent[300:305], [link.sent[299]] * 5)
    assert flown.summary.updates > 280  # counted from the defect on


def test_what_cannot_be_recorded_is_learnt_all_the_same(cast, plant_link, tmp_path, monkeypatch):
    link, lines, well = plant_link(600), [], Recorder.innovation

    def fails(recorder, *given):
        if 300 <= link.tick < 305:
            raise OverflowError("too large")
        well(recorder, *given)

    monkeypatch.setattr(Recorder, "innovation", fails)
    (flown,) = fly(link, cast, tmp_path / "f.ulg", say=lines.append)
    assert flown.outcome is Outcome.OVER
    assert flown.summary.health["defect"] == 5
    assert len([line for line in lines if "the runtime failed: OverflowError: too large" in line]) == 1
    assert flown.summary.updates == 600 - 3


def test_a_flight_that_begins_with_garbage_has_a_reference_for_all_that(cast, plant_link, tmp_path):
    """The first flight waits for a state that can be used; one that takes its place begins with whatever came."""
    asked = []

    def blind(tick, x):
        asked.append(tick)
        return x * np.nan if 301 <= len(asked) < 304 else x

    link = TwoFlights(lambda ticks: plant_link(ticks, state=blind), 2)
    first, second = fly(link, cast, tmp_path / "f.ulg", reference=LiveReference())
    assert (first.summary.cycles, second.summary.cycles) == (300, 200)
    assert second.summary.health["state_not_finite"] == 3
    assert "action_not_finite" not in second.summary.health
    assert np.ptp(link.commands[1], axis=0).max() > 0.0


def test_before_the_first_good_command_there_is_none_in_real_time_either(cast, plant_link, tmp_path, monkeypatch):
    """Zero deflection is no command to send only because a flight began with garbage, and then nothing came."""
    asked = []

    def blind(tick, x):
        asked.append(tick)
        return x * np.nan if len(asked) == 301 else x

    link = TwoFlights(lambda ticks: plant_link(ticks, state=blind), 2)
    silent, read = iter([False] * 301 + [True] * 5), link.read
    link.read = lambda timeout: None if next(silent, False) else read(timeout)
    monkeypatch.setattr(SteppedClock, "overdue", lambda clock: True)
    _, second = fly(link, cast, tmp_path / "f.ulg")
    assert second.summary.health["state_missing"] == 5
    assert len(link.commands[1]) == 200
    assert np.abs(link.commands[1]).max(axis=1).min() > 0.0


def test_a_summary_counts_its_own_flight_alone(cast, plant_link, tmp_path):
    link = TwoFlights(plant_link, 2)
    link.skipped, link.repeated, read = 1, 2, link.read  # before the first state

    def busy(timeout):
        sample = read(timeout)
        if sample is not None and sample.time_usec % 1_000_000 == 0:
            link.skipped, link.repeated = link.skipped + 1, link.repeated + 3
        return sample

    link.read = busy
    flown = fly(link, cast, tmp_path / "f.ulg")
    assert [(each.summary.skipped, each.summary.repeated) for each in flown] == [(5, 14), (1, 3)]


def test_a_live_reference_flies_level_until_told(cast, plant_link, tmp_path):
    live = LiveReference()

    class Told(plant_link):
        def read(self, timeout):
            if self.tick == 500:
                live.set(0.056, 0.15)
            return super().read(timeout)

    link = Told(1500)
    fly(link, cast, tmp_path / "f.ulg", reference=live)
    x = np.array(link.x)
    assert abs(x[499, STATE.phi]) < 0.02
    assert x[-1, STATE.phi] == pytest.approx(0.15, abs=0.05)


def test_a_session_in_real_time_gives_back_what_it_took(cast, plant_link, tmp_path):
    before = gc.isenabled(), gc.get_freeze_count(), os.sched_getscheduler(0), sys.getswitchinterval()
    (flown,) = fly(plant_link(20), cast, tmp_path / "f.ulg", overrides=("real_time=true",))
    assert "real time: " in flown.summary.real_time[0]
    assert (gc.isenabled(), gc.get_freeze_count(), os.sched_getscheduler(0), sys.getswitchinterval()) == before
    assert fly(plant_link(20), cast, tmp_path / "f.ulg")[0].summary.real_time == []


def test_a_set_point_is_of_its_own_flight_alone(cast, plant_link, tmp_path):
    live = LiveReference()
    live.set(0.056, 0.15)  # before the first state: of the first flight

    class Told(TwoFlights):
        def read(self, timeout):
            if len(self.commands) == 2 and self.now.tick == 100:
                live.set(0.02, -0.1)
            return super().read(timeout)

    link = Told(plant_link, 2)
    first, second = fly(link, cast, tmp_path / "f.ulg", reference=live)
    asked = [topics(flown.log)["cycle"] for flown in (first, second)]
    np.testing.assert_allclose(asked[0]["phi_ref"], 0.15, atol=1e-7)
    assert asked[1]["theta_ref"][0] == pytest.approx(asked[1]["theta"][0])
    np.testing.assert_allclose(asked[1]["phi_ref"], np.where(np.arange(200) < 100, 0.0, -0.1), atol=1e-7)
    (third,) = fly(plant_link(20), cast, tmp_path / "f.ulg", reference=live)
    np.testing.assert_array_equal(topics(third.log)["cycle"]["phi_ref"], 0.0)


def test_commands_are_within_limits_whatever_the_model_says(cast, plant_link, tmp_path):
    link = plant_link(1500, weak_elevator)
    fly(link, cast, tmp_path / "f.ulg", "thesis", ("p0=1e6", "margin=0"))
    assert np.abs(link.sent).max() <= DEFLECTION_LIMIT


def test_a_stop_is_heeded_between_samples(cast, plant_link, tmp_path):
    link = plant_link(2000)
    (flown,) = fly(link, cast, tmp_path / "f.ulg", stopped=lambda: link.tick >= 100)
    assert flown.outcome is Outcome.STOPPED
    assert flown.summary.cycles == 100


KILLED = """
import sys, time
from pathlib import Path
sys.path.insert(0, {here!r})
import conftest
from runtime.presets import resolve
from runtime.identification import IncrementalModel
from runtime.population import load_population
from runtime.reference import LiveReference
from runtime.session import Session
class Slow(conftest.PlantLink):
    def read(self, timeout):
        time.sleep(0.002)
        return super().read(timeout)
with Session(Slow(10**6), load_population(Path({cast!r})), LiveReference(), resolve(), Path({log!r})) as session:
    session.fly()
"""


def test_a_log_is_readable_after_kill_9(cast_folder, tmp_path):
    log = tmp_path / "f.ulg"
    code = KILLED.format(here=str(Path(__file__).parent), cast=str(cast_folder), log=str(log))
    process = subprocess.Popen([sys.executable, "-c", code])
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline and (not log.exists() or log.stat().st_size < 40_000):
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    cycle = topics(log)["cycle"]
    assert len(cycle["tick"]) > 100
    assert list(cycle["tick"]) == list(range(len(cycle["tick"])))


def test_the_plant_s_command_lag_is_the_one_that_the_model_carries(cast):
    """With the stated lag the model foresees the pitch rate far better than with any other."""
    rng = np.random.default_rng(0)
    plant = Plant()
    models = [IncrementalModel(resolve("understudy", None, ("prior=none",)).adaptation, lag) for lag in range(4)]
    squares = np.zeros(len(models))
    action = plant.trim.action.copy()
    for k in range(600):
        if k % 7 == 0:
            action = plant.trim.action + np.array([0.01, 0.01, 0.01]) * rng.normal(size=3)
        for i, model in enumerate(models):
            model.observe(plant.x)
            model.command(action)
            if k > 300:
                squares[i] += model.rls.innovation[STATE.q] ** 2
        plant.step(action)
    assert int(np.argmin(squares)) == cast.command_lag
    assert squares[cast.command_lag] < 0.05 * np.delete(squares, cast.command_lag).min()
