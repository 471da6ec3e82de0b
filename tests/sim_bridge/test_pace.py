"""Deadlines that do not drift and are never repaid."""

from __future__ import annotations

import time

import pytest

from sim_bridge.pace import Pace

PERIOD = 0.02


def test_deadlines_are_multiples_of_the_period_however_late_the_loop_is():
    pace = Pace(PERIOD, 10)
    pace.start()
    first = pace.next()
    time.sleep(0.5 * PERIOD)
    second = pace.next()
    assert second - first == pytest.approx(PERIOD)


def test_an_overrun_is_counted_and_its_deadlines_are_given_up():
    pace = Pace(PERIOD, 10)
    pace.start()
    first = pace.next()
    time.sleep(max(first - time.perf_counter(), 0.0) + 3.5 * PERIOD)
    missed = pace.woken()
    assert missed >= 3
    following = pace.next()
    assert following > time.perf_counter()
    assert (following - first) / PERIOD == pytest.approx(missed + 1)


def test_a_small_delay_is_no_overrun_but_is_in_the_jitter():
    pace = Pace(1.0, 10)
    pace.start()
    pace._start -= 1.1  # a tenth of a period after the first deadline
    pace.next()
    assert pace.woken() == 0
    (lateness,) = pace.lateness()
    assert lateness == pytest.approx(0.1, abs=0.05)
