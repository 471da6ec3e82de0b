"""The cycle by itself, with stand-ins for what it calls: what is asked of whom for which state, and what is said."""

from types import SimpleNamespace

import numpy as np
import pytest

from runtime.config import Operation
from runtime.continuity import Continuity
from runtime.guard import Guard, Health
from runtime.link import Sample, Severity
from runtime.loop import Loop, Outcome
from runtime.switching import Action, Decision, Reason
from task.state import STATE

LEVEL = np.zeros(12)
LEVEL[[STATE.V, STATE.h, STATE.xe]] = 90.0, 2000.0, 7.0
NOT_FINITE, IMPLAUSIBLE = LEVEL.copy(), LEVEL.copy()
NOT_FINITE[STATE.q], IMPLAUSIBLE[STATE.q] = np.nan, 50.0
TURNED = LEVEL.copy()
TURNED[[STATE.phi, STATE.theta]] = 0.3
FORETOLD = np.arange(10.0)
STEERED, PULSE = 0.01, 0.002
"""What the policy commands of a state's speed, and what excitation adds."""


@pytest.fixture(autouse=True)
def states_may_stand_still(monkeypatch):
    """Most flights here are of one state."""
    monkeypatch.setattr(Continuity, "STILL", 10**9)


class Parts:
    """All that the loop calls; what it asks for is in ``done``, in order."""

    def __init__(self, coasts=0):
        self.done, self.sent, self.lines, self.reads = [], [], [], []
        self.coasts, self.ended, self.clock_overdue = coasts, "", False
        self.decision = None
        self.model = SimpleNamespace(
            effectiveness=None, coasting=0, rls=SimpleNamespace(innovation=np.zeros(6), trace=0.0),
            coast=self.coast, observe=lambda x: self.note("observe"), answered=lambda x: x,
            restart_history=self.forget,
            reset=lambda: self.note("model reset"), command=lambda command: self.note("command"),
        )  # fmt: skip
        self.policy = SimpleNamespace(
            steer=self.steer, sent=lambda command: None, restart_history=lambda: self.note("policy forgets")
        )
        self.cast = SimpleNamespace(
            step=lambda: self.note("cast steps"), take=lambda decision: self.note("taken"), blend=0.0, flying=0
        )
        self.excitation = SimpleNamespace(add=lambda action: action + PULSE, surface=-1)
        self.reference = SimpleNamespace(start=lambda x: self.note("reference starts"), at=lambda t: np.full(3, t))
        self.recorder = SimpleNamespace(
            cycle=lambda *of: self.note(f"recorded {of[7]}"), innovation=lambda *of: None,
            play=lambda *of: self.note("play recorded"), message=lambda *of: None, trouble=lambda: "",
        )  # fmt: skip
        self.plays = SimpleNamespace(step=self.play)
        self.clock = SimpleNamespace(arrived=lambda: None, overdue=lambda: self.clock_overdue, wait=lambda: 0.0)

    def note(self, what):
        self.done.append(what)

    def coast(self):
        self.note("coast")
        self.coasts -= 1
        if self.coasts < 0:
            return None
        self.model.coasting += 1
        return FORETOLD

    def forget(self, missed):
        self.note(f"model forgets {missed}")
        self.model.coasting = 0

    def steer(self, x, reference):
        self.note("steer")
        self.seen = x, reference
        return np.full(3, STEERED)

    def play(self, tick, t):
        self.note(f"plays at {tick}")
        return self.decision

    def read(self, timeout):
        return self.reads.pop(0) if self.reads else None

    def write(self, command, time_usec):
        self.sent.append((float(command[0]), time_usec))

    def say(self, text, severity):
        self.lines.append((severity, text))

    def loop(self, stopped=lambda: False, **operation):
        settings = Operation(**operation)
        return Loop(
            self, self.clock, self.policy, self.cast, self.model, self.plays, self.reference, Guard(settings),
            self.recorder, self.excitation, settings, ["good", "lazy"], stopped=stopped,
        )  # fmt: skip

    def flown(self, *states, **operation):
        """Return a loop that has answered some states; what it did for the last one alone is in ``done``."""
        loop = self.loop(**operation)
        samples = [Sample(k * 10_000, 1, x) for k, x in enumerate(states)]
        loop.begin(samples[0])
        for sample in samples:
            self.done.clear()
            loop.cycle(sample)
        return loop


def test_a_good_state_is_learnt_from_steered_on_and_recorded():
    parts = Parts()
    parts.flown(LEVEL, LEVEL, LEVEL)
    assert parts.done == ["observe", "plays at 2", "cast steps", "steer", "command", "recorded 0"]
    assert parts.sent == [(STEERED + PULSE, k * 10_000) for k in range(3)]
    np.testing.assert_array_equal(parts.seen[1], 0.02)


def test_the_reference_starts_with_the_first_state_that_can_be_used_and_once():
    parts = Parts()
    loop = parts.flown(NOT_FINITE)
    assert "reference starts" not in parts.done
    assert (parts.sent, loop.cycles, loop.health_counts["state_not_finite"]) == ([], 0, 1)
    parts.done.clear()
    for k in (1, 2, 3):
        loop.cycle(Sample(k * 10_000, 1, LEVEL))
    assert parts.done.count("reference starts") == 1
    assert (len(parts.sent), loop.cycles, loop.gaps) == (3, 3, 0)


@pytest.mark.parametrize("garbage", [NOT_FINITE, IMPLAUSIBLE, TURNED])
def test_the_model_stands_in_for_a_state_that_cannot_be_relied_upon_and_nothing_is_learnt(garbage):
    parts = Parts(coasts=9)
    parts.flown(LEVEL, LEVEL, garbage)
    *asked, recorded = parts.done
    assert asked == ["coast", "cast steps", "steer", "command"]
    assert int(recorded.split()[1]) & Health.COASTING
    np.testing.assert_array_equal(parts.seen[0], [*FORETOLD, 0.0, 0.0])
    np.testing.assert_array_equal(parts.seen[1], 0.02)
    assert parts.sent[-1] == (STEERED, 20_000)  # without a pulse


@pytest.mark.parametrize("garbage", [NOT_FINITE, IMPLAUSIBLE])
def test_without_a_model_the_last_command_is_held_through_states_that_cannot_be_used(garbage):
    parts = Parts()
    parts.flown(LEVEL, LEVEL, garbage)
    *asked, recorded = parts.done
    assert asked == ["coast", "model forgets 0", "policy forgets", "command"]
    assert int(recorded.split()[1]) & Health.HOLDING
    assert parts.sent[-1] == (STEERED + PULSE, 20_000)


def test_without_a_model_a_state_that_jumps_is_flown_on_and_not_learnt_from():
    parts = Parts()
    parts.flown(LEVEL, LEVEL, TURNED)
    assert parts.done == ["coast", "model forgets 0", "steer", "command", f"recorded {int(Health.STATE_JUMPS)}"]
    np.testing.assert_array_equal(parts.seen[0], TURNED)
    assert parts.sent[-1] == (STEERED, 20_000)


def test_a_model_that_can_no_longer_stand_in_is_not_asked_again_until_a_state_can_be_relied_upon():
    parts = Parts(coasts=1)
    loop, asked = parts.flown(LEVEL, LEVEL), []
    for k, x in enumerate((NOT_FINITE, NOT_FINITE, NOT_FINITE, LEVEL, NOT_FINITE), 2):
        parts.done.clear()
        loop.cycle(Sample(k * 10_000, 1, x))
        asked.append("coast" in parts.done)
    assert asked == [True, True, False, False, True]


@pytest.mark.parametrize(("coasted", "forgets"), [(0, []), (10, ["model"]), (11, ["model", "policy"])])
def test_after_coasting_the_model_forgets_the_last_samples_and_whoever_flies_those_of_long_ago(coasted, forgets):
    parts = Parts()
    loop = parts.flown(LEVEL, LEVEL)
    parts.model.coasting = coasted
    parts.done.clear()
    loop.cycle(Sample(20_000, 1, LEVEL))
    assert [each.split()[0] for each in parts.done if "forgets" in each] == forgets
    assert parts.done[len(forgets)] == "observe"


@pytest.mark.parametrize(
    ("step", "missed"),
    [(0, 0), (5_000, 0), (5_001, None), (14_999, None), (15_000, 1), (24_000, 1), (26_000, 2), (60_000, 5)],
)
def test_a_gap_is_less_than_half_or_at_least_one_and_a_half_samples(step, missed):
    parts = Parts()
    loop = parts.flown(LEVEL, LEVEL)
    parts.done.clear()
    loop.cycle(Sample(10_000 + step, 1, LEVEL))
    asked = ["coast"] * bool(missed)
    forgotten = [] if missed is None else [f"model forgets {missed}", "policy forgets"]
    assert parts.done[: len(asked + forgotten) + 1] == [*asked, *forgotten, "observe"]
    assert loop.health_counts["gap"] == loop.gaps == (missed is not None)


@pytest.mark.parametrize(("missed", "shown"), [(1, 1), (10, 10), (11, 0)])
def test_through_a_short_gap_whoever_flies_is_shown_what_the_model_foretells_and_goes_on(missed, shown):
    parts = Parts(coasts=100)
    loop = parts.flown(LEVEL, LEVEL)
    told = []
    parts.model.command = lambda command: told.append(float(command[0]))
    parts.done.clear()
    loop.cycle(Sample(20_000 + 10_000 * missed, 1, LEVEL))
    before = ["coast", "steer"] * shown
    after = ["model forgets 0"] if shown else [f"model forgets {missed}", "policy forgets"]
    assert parts.done[: len(before + after) + 1] == [*before, *after, "observe"]
    assert told == [STEERED + PULSE] * (shown + 1)  # the last command was held, and then the new one
    np.testing.assert_array_equal(parts.seen[0], LEVEL)


def test_a_gap_that_is_bridged_in_part_counts_its_commands_once_and_its_time_goes_on():
    parts = Parts(coasts=2)
    loop, times = parts.flown(LEVEL, LEVEL), []
    steer = parts.policy.steer
    parts.policy.steer = lambda x, reference: (times.append(float(reference[0])), steer(x, reference))[1]
    parts.done.clear()
    loop.cycle(Sample(50_000, 1, LEVEL))  # three are missing
    assert parts.done.count("coast") == 3
    assert "model forgets 1" in parts.done
    assert "policy forgets" in parts.done
    np.testing.assert_allclose(times, [0.02, 0.03, 0.05])


def test_garbage_after_a_gap_is_answered_from_what_was_known_before_it():
    parts = Parts(coasts=100)
    loop = parts.flown(LEVEL, LEVEL)
    parts.done.clear()
    loop.cycle(Sample(40_000, 1, NOT_FINITE))
    missing = ["coast", "steer", "command"]
    assert parts.done[:9] == [*missing, *missing, "coast", "cast steps", "steer"]
    assert not [each for each in parts.done if "forgets" in each]


def test_states_that_cannot_be_used_are_compared_with_nothing():
    """An attitude before and after them may well differ by what no rate turns it in a sample."""
    parts = Parts()
    loop = parts.flown(LEVEL)
    assert loop.check(Sample(10_000, 1, NOT_FINITE)) == (Health.STATE_NOT_FINITE, None)
    loop = parts.flown(LEVEL)
    assert loop.check(Sample(10_000, 1, TURNED)) == (Health.STATE_JUMPS, None)


def test_a_sample_that_did_not_come_is_answered_by_the_last_gate_once_there_was_a_command():
    parts = Parts()
    loop = parts.loop()
    loop.begin(Sample(0, 1, LEVEL))
    loop.miss()
    assert parts.sent == []
    assert loop.health_counts["state_missing"] == 1
    loop.cycle(Sample(0, 1, LEVEL))
    loop.miss()
    assert parts.sent[1:] == [(STEERED + PULSE, 0)]
    assert loop.health_counts["state_missing"] == 2


def test_a_flag_is_counted_each_time_and_said_once_in_so_many_cycles():
    parts = Parts()
    loop = parts.flown(LEVEL)
    sample = Sample(10_000, 1, LEVEL)
    for _ in range(3):
        loop.report(sample, Health.GAP)
    loop.report(sample, Health.GAP | Health.HOLDING)
    assert parts.lines == [
        (Severity.WARNING, "samples are missing"), (Severity.WARNING, "holding the last good command, then trim"),
    ]  # fmt: skip
    loop.cycles = 1 + Loop.SAY_AGAIN - 1
    loop.report(sample, Health.GAP)
    assert len(parts.lines) == 2
    loop.cycles += 1
    loop.report(sample, Health.GAP)
    assert len(parts.lines) == 3
    assert loop.health_counts == {"gap": 6, "holding": 1}


def test_another_flight_is_one_with_another_number_or_an_earlier_time():
    loop = Parts().flown(LEVEL, LEVEL, LEVEL)
    assert not loop.replaces(Sample(20_000, 1, LEVEL))
    assert not loop.replaces(Sample(30_000, 1, LEVEL))
    assert loop.replaces(Sample(19_999, 1, LEVEL))
    assert loop.replaces(Sample(30_000, 2, LEVEL))


def test_a_flight_ends_as_the_link_says_or_when_it_is_stopped_or_replaced():
    parts = Parts()
    parts.ended = "lost"
    assert parts.loop().fly(Sample(0, 1, LEVEL)) is Outcome.LOST
    parts = Parts()
    parts.reads = [Sample(10_000, 1, LEVEL), Sample(10_000, 2, LEVEL)]
    loop = parts.loop()
    assert loop.fly(Sample(0, 1, LEVEL)) is Outcome.REPLACED
    assert (loop.next_flight.flight, loop.cycles) == (2, 2)
    parts = Parts()
    assert parts.loop(stopped=lambda: True).fly(Sample(0, 1, LEVEL)) is Outcome.STOPPED
    assert len(parts.sent) == 1


def test_silence_ends_a_flight_after_patience_and_until_then_is_answered_when_a_sample_is_overdue(monkeypatch):
    wall = SimpleNamespace(now=0.0, perf_counter_ns=lambda: 0)
    wall.monotonic = lambda: wall.now
    monkeypatch.setattr("runtime.loop.time", wall)
    parts = Parts()
    overdue = iter([False, True, True])

    def pass_time():
        wall.now += 0.5
        return next(overdue)

    parts.clock.overdue = pass_time
    assert parts.loop(patience=1.4).fly(Sample(0, 1, LEVEL)) is Outcome.SILENT
    assert len(parts.sent) == 3  # the answer, and two for samples that did not come
    assert wall.now == 1.5


def test_a_cycle_longer_than_a_sample_is_an_overrun(monkeypatch):
    for longest, overruns in ((9_999_999, 0), (10_000_001, 1)):
        parts = Parts()
        loop = parts.loop()
        loop.begin(Sample(0, 1, LEVEL))
        times = iter([0, 4_000_000, longest])
        monkeypatch.setattr("runtime.loop.time", SimpleNamespace(perf_counter_ns=lambda times=times: next(times)))
        loop.cycle(Sample(0, 1, LEVEL))
        assert loop.overruns == overruns
        assert list(loop.cycle_us) == [4000.0]


def test_a_decision_is_taken_recorded_and_said_where_it_changes_the_cast():
    for action, switches in ((Action.KEEP, 0), (Action.SOFT, 1)):
        parts = Parts()
        parts.decision = SimpleNamespace(
            decision=Decision(action, 1, Reason.BETTER, 1.0), error="", returns=np.zeros(3), age=0.1, tick_asked=0,
            describe=lambda members: f"to {members[1]}",
        )  # fmt: skip
        loop = parts.flown(LEVEL)
        assert parts.done[2:5] == ["plays at 0", "taken", "cast steps"]
        assert "play recorded" in parts.done
        assert loop.switches == switches
        assert parts.lines == [(Severity.INFO, "to lazy")] * switches


def test_an_imagination_that_failed_is_said():
    parts = Parts()
    parts.decision = SimpleNamespace(
        decision=Decision(Action.KEEP, -1, Reason.NO_PREDICTION, 0.0), error="no memory", returns=np.zeros(3), age=0.1,
        tick_asked=0,
    )  # fmt: skip
    parts.flown(LEVEL)
    assert parts.lines == [(Severity.WARNING, "imagination failed: no memory")]


@pytest.mark.parametrize(("since", "t"), [("zero", 5.0), ("first_state", 0.0)])
def test_the_reference_counts_from_time_zero_or_from_the_first_state_and_ticks_from_the_first_state(since, t):
    parts = Parts()
    loop = parts.loop(reference_from=since)
    loop.begin(Sample(5_000_000, 1, LEVEL))
    loop.cycle(Sample(5_000_000, 1, LEVEL))
    np.testing.assert_allclose(parts.seen[1], t)
    assert loop.tick(Sample(5_030_400, 1, LEVEL)) == 3
    loop.cycle(Sample(5_010_000, 1, LEVEL))
    assert "plays at 1" in parts.done


def test_after_a_defect_what_was_learnt_is_forgotten_and_the_last_command_held():
    parts = Parts()
    loop = parts.flown(LEVEL, LEVEL)

    def fails(x):
        raise OverflowError("too large")

    parts.model.observe = fails
    parts.done.clear()
    for k in (2, 3):
        loop.cycle(Sample(k * 10_000, 1, LEVEL))
    assert parts.done[:3] == ["model reset", "policy forgets", "command"]
    assert parts.sent[2:] == [(STEERED + PULSE, 20_000), (STEERED + PULSE, 30_000)]
    assert loop.health_counts["defect"] == 2
    severities = [severity for severity, text in parts.lines if text.startswith("the runtime failed: Overfl")]
    assert severities == [Severity.CRITICAL]
