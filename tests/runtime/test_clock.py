import gc
import os
import sys
import time
from pathlib import Path

import pytest

from runtime import clock
from runtime.clock import RateKeeper, SteppedClock, hardened


def found():
    """Return everything of this thread and process that real time changes."""
    locked = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmLck")]
    return (
        os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, os.sched_getaffinity(0), gc.isenabled(),
        gc.get_freeze_count(), sys.getswitchinterval(), locked,
    )  # fmt: skip


@pytest.mark.parametrize("collecting", [True, False])
def test_real_time_ends_where_it_was_asked_for(collecting):
    (gc.enable if collecting else gc.disable)()
    before = found()
    try:
        with hardened(min(os.sched_getaffinity(0))) as report:
            assert len(report) == 3
            assert not gc.isenabled()
            assert gc.get_freeze_count() > 0
            assert len(os.sched_getaffinity(0)) == 1
            within = found()
        assert found() == before != within
        with pytest.raises(ZeroDivisionError), hardened(-1):
            raise ZeroDivisionError
        assert found() == before
    finally:
        gc.enable()


def test_who_may_not_take_back_the_reset_on_fork_is_scheduled_as_before_all_the_same(monkeypatch):
    asked = []

    def schedule(pid, policy, parameters):
        asked.append((pid, policy))
        if not policy & os.SCHED_RESET_ON_FORK:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(clock.os, "sched_setscheduler", schedule)
    with hardened(-1) as report:
        assert report[0] == "real time: SCHED_FIFO, priority 50"
    flag, before = os.SCHED_RESET_ON_FORK, os.sched_getscheduler(0)
    assert asked == [(0, os.SCHED_FIFO | flag), (0, before), (0, before | flag)]


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


def test_simulated_time_is_never_late():
    clock = SteppedClock()
    clock.arrived()
    assert not clock.overdue()
    assert clock.missed == 0
    assert 0.0 < clock.wait() <= 1.0
