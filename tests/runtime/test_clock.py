import time

import pytest

from runtime.clock import RateKeeper, SteppedClock, harden


class Wall:
    """A clock on the wall that somebody sets."""

    now = 100.0

    def monotonic(self):
        return self.now


@pytest.fixture
def wall(monkeypatch):
    wall = Wall()
    monkeypatch.setattr("runtime.clock.time", wall)
    return wall


def test_a_late_sample_is_counted_once_and_never_repaid():
    keeper = RateKeeper(0.02, 1.5)
    keeper.arrived()
    assert not keeper.overdue()
    assert 0.0 < keeper.wait() <= 0.03
    time.sleep(0.035)
    assert keeper.wait() == 0.0
    assert keeper.overdue()
    assert keeper.missed >= 1
    before = keeper.missed
    assert not keeper.overdue() or keeper.missed > before
    keeper.arrived()
    assert not keeper.overdue()


def test_an_overrun_of_many_samples_is_skipped_not_worked_off():
    keeper = RateKeeper(0.01, 1.5)
    keeper.arrived()
    time.sleep(0.1)
    assert keeper.overdue()
    assert keeper.missed >= 8
    assert keeper.wait() > 0.0


def test_a_sample_is_missed_after_factor_sample_times_and_each_sample_time_from_there_counts_one_more(wall):
    keeper = RateKeeper(0.02, 1.5)
    assert keeper.wait() == pytest.approx(0.03)
    wall.now += 0.029
    assert keeper.wait() == pytest.approx(0.001)
    assert not keeper.overdue()
    assert keeper.missed == 0
    wall.now += 0.002  # 31 ms
    assert keeper.wait() == 0.0
    assert keeper.overdue()
    assert not keeper.overdue()
    assert keeper.missed == 1
    assert keeper.wait() == pytest.approx(0.019)  # the next is due 50 ms after the last that came
    wall.now += 0.020
    assert keeper.overdue()
    assert keeper.missed == 2


def test_deadlines_that_passed_unseen_are_counted_at_once_and_the_next_lies_ahead(wall):
    keeper = RateKeeper(0.02, 1.5)
    wall.now += 0.115  # due at 30, 50, 70, 90 and 110 ms
    assert keeper.overdue()
    assert keeper.missed == 5
    assert not keeper.overdue()
    assert keeper.wait() == pytest.approx(0.015)


def test_a_sample_that_comes_sets_when_the_next_is_due(wall):
    keeper = RateKeeper(0.02)
    wall.now += 0.025
    keeper.arrived()
    wall.now += 0.025
    assert not keeper.overdue()
    assert keeper.wait() == pytest.approx(0.005)
    wall.now += 1.0
    keeper.arrived()
    assert not keeper.overdue()
    assert keeper.missed == 0


def test_a_sample_is_overdue_at_its_very_deadline(wall):
    wall.now = 0.0
    keeper = RateKeeper(0.5, 1.5)
    wall.now = 0.75
    assert keeper.overdue()
    assert keeper.missed == 1
    wall.now = 1.25
    assert keeper.overdue()
    assert keeper.missed == 2


def test_simulated_time_is_never_late():
    clock = SteppedClock()
    clock.arrived()
    assert not clock.overdue()
    assert clock.missed == 0
    assert clock.wait() == SteppedClock.SLICE == 0.2


class System:
    """What real time is asked of; ``refuses`` names what it does not give."""

    SCHED_FIFO, SCHED_RESET_ON_FORK = 1, 0x40000000

    def __init__(self, refuses=()):
        self.refuses, self.asked = refuses, []

    def ask(self, what, *of):
        self.asked.append((what, *of))
        if what in self.refuses:
            raise PermissionError(1, "Operation not permitted")

    def sched_param(self, priority):
        return priority

    def sched_setscheduler(self, pid, policy, param):
        self.ask("fifo", pid, policy, param)

    def sched_setaffinity(self, pid, cores):
        self.ask("core", pid, cores)

    def strerror(self, number):
        return f"error {number}"

    def CDLL(self, name, use_errno):
        return self

    def mlockall(self, flags):
        self.asked.append(("memory", flags))
        return -1 if "memory" in self.refuses else 0

    def get_errno(self):
        return 12

    def collect(self):
        self.asked.append(("collect",))

    def freeze(self):
        self.asked.append(("freeze",))

    def disable(self):
        self.asked.append(("disable",))

    def setswitchinterval(self, seconds):
        self.asked.append(("turns", seconds))


def hardened(monkeypatch, *given, **of):
    system = System(**of)
    for module in ("os", "ctypes", "gc", "sys"):
        monkeypatch.setattr(f"runtime.clock.{module}", system)
    return harden(*given), system.asked


QUIET = [("collect",), ("freeze",), ("disable",), ("turns", 5e-4)]
"""Asked of the interpreter, in this order: what is garbage goes before the rest is frozen."""


def test_real_time_asks_for_everything_and_says_that_it_got_it(monkeypatch):
    report, asked = hardened(monkeypatch, 3)
    assert report == ["real time: SCHED_FIFO, priority 50", "real time: memory locked", "real time: pinned to core 3"]
    assert asked == [("fifo", 0, 0x40000001, 50), ("memory", 1), ("core", 0, {3}), *QUIET]


def test_real_time_pins_to_core_0_and_to_none_below(monkeypatch):
    report, asked = hardened(monkeypatch, 0, 20)
    assert ("core", 0, {0}) in asked
    assert report[0] == "real time: SCHED_FIFO, priority 20"
    report, asked = hardened(monkeypatch, -1)
    assert len(report) == 2
    assert [what[0] for what in asked] == ["fifo", "memory", "collect", "freeze", "disable", "turns"]


def test_what_the_system_refuses_is_said_and_the_rest_is_asked_for_all_the_same(monkeypatch):
    report, asked = hardened(monkeypatch, 3, refuses=("fifo", "memory", "core"))
    assert report == [
        "real time: no SCHED_FIFO (Operation not permitted); allow it with 'setcap cap_sys_nice' or limits.conf",
        "real time: memory not locked (error 12); raise 'ulimit -l'",
        "real time: not pinned to core 3 (Operation not permitted)",
    ]
    assert asked[3:] == QUIET


def test_a_system_that_knows_no_real_time_is_said_too(monkeypatch):
    monkeypatch.setattr(System, "sched_setscheduler", property(lambda system: system.nothing_like_it))
    report, _ = hardened(monkeypatch, -1)
    assert report[0].startswith("real time: no SCHED_FIFO ('System' object has no attribute")
