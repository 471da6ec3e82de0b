import time

from runtime.clock import RateKeeper, SteppedClock


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
