import time

import pytest

from runtime.clock import RateKeeper, SteppedClock


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
    assert 0.0 < clock.wait() <= 1.0
