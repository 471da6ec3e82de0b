"""The signs of an alarm, each at its threshold, and what of the time after it counts as what."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from runtime.alarm import Alarm
from runtime.config import Adaptation
from runtime.opening import Opening, Recollection
from runtime.rate_filter import LAMBDA, N
from runtime.shift import Shift
from task.limits import DT

PLAIN = Adaptation(
    alarm_threshold=75.0, alarm_colour=0.3, agile_lead=(30.0, 55.0, 50.0), alarm_shift=40.0, delay_memory=0.99
)
STILL = [1.0, 1.0, 1.0]
ROUGH = [1.0, math.e, 1.0]
"""Levels of turbulence: thresholds grow by ``alarm_colour``."""


def surprised(alarm, nis, levels=STILL):
    """Return at which samples an alarm sounds."""
    return [k for k, each in enumerate(nis) if alarm.sounds(each, levels)]


def test_five_innovations_that_add_up_to_more_than_the_threshold_are_an_alarm():
    assert surprised(Alarm(PLAIN, DT), [15.0] * 20) == []
    assert surprised(Alarm(PLAIN, DT), [3.0, 15.0, 15.0, 15.0, 15.0, 15.1, 14.9]) == [5]
    assert surprised(Alarm(PLAIN, DT), [75.1, *[0.0] * 9]) == [0, 1, 2, 3, 4]


def test_turbulence_on_any_axis_raises_the_threshold():
    assert surprised(Alarm(PLAIN, DT), [0.0, 97.4], ROUGH) == []
    assert surprised(Alarm(PLAIN, DT), [0.0, 97.6], ROUGH) == [1]


def test_an_innovation_that_is_no_number_is_an_alarm_and_leaves_none_for_good():
    alarm = Alarm(PLAIN, DT)
    assert surprised(alarm, [math.nan, *[0.0] * 9]) == [0, 1, 2, 3, 4]
    assert surprised(alarm, [math.inf, *[0.0] * 9]) == [0, 1, 2, 3, 4]
    assert sum(alarm._nis) == 0.0


def test_what_surprised_before_a_gap_is_forgotten():
    for forget in (Alarm.forget_surprise, Alarm.restart):
        alarm = Alarm(PLAIN, DT)
        assert surprised(alarm, [70.0]) == []
        forget(alarm)
        assert surprised(alarm, [70.0]) == []


@pytest.mark.parametrize(("surface", "lead"), enumerate(PLAIN.agile_lead))
def test_an_agile_filter_that_leads_for_three_samples_is_an_alarm(surface, lead):
    def sounded(beyond, levels):
        alarm = Alarm(PLAIN, DT)
        alarm.leads[surface] = beyond
        return surprised(alarm, [0.0] * 5, levels)

    assert sounded(lead, STILL) == []
    assert sounded(lead + 0.1, STILL) == [2, 3, 4]
    assert sounded(1.3 * lead - 0.1, ROUGH) == []
    assert sounded(1.3 * lead + 0.1, ROUGH) == [2, 3, 4]


def test_a_lead_that_is_lost_or_lies_before_a_gap_counts_from_the_beginning():
    alarm = Alarm(PLAIN, DT)
    sounded = []
    for lead in (31.0, 31.0, 0.0, 31.0, 31.0, 31.0):
        alarm.leads[0] = lead
        sounded.append(alarm.sounds(0.0, STILL))
    assert sounded == [False] * 5 + [True]
    alarm.restart()
    assert surprised(alarm, [0.0] * 3) == [2]


def test_leads_add_up_with_forgetting_and_are_never_below_zero():
    alarm = Alarm(PLAIN, DT)
    alarm.compare([2.0, 1.0, -1.0], 1.0)
    assert alarm.leads == [1.0, 0.0, 0.0]
    alarm.compare([1.0, 4.0, 1.5], 1.0)
    assert alarm.leads == pytest.approx([0.99, 3.0, 0.5])
    alarm.clear()
    assert alarm.leads == [0.0, 0.0, 0.0]


def test_a_bias_that_has_left_its_mean_by_more_than_alarm_shift_is_an_alarm():
    alarm = Alarm(PLAIN, DT)
    alarm.shift.size = PLAIN.alarm_shift
    assert surprised(alarm, [0.0]) == []
    alarm.shift.size = PLAIN.alarm_shift + 0.1
    assert surprised(alarm, [0.0]) == [0]


NEVER_BLIND = (False, False, False)


def test_a_step_of_the_bias_is_as_large_as_its_drift_lets_a_mean_lag_behind():
    """Of a random walk less its running mean the variance is q^2 / (2 gain)."""
    drift, gain = (2e-3, 1e-3, 5e-4), 0.01
    shift = Shift(drift, 1.0, 0.01)
    for axis, (each, level) in enumerate(zip(drift, (1.0, 4.0, 9.0), strict=True)):
        shift.restart([1.0, -2.0, 3.0])
        moved = [1.0, -2.0, 3.0]
        moved[axis] += 0.5
        levels = [1.0, 1.0, 1.0]
        levels[axis] = level
        shift.learn(moved, levels, NEVER_BLIND)
        assert shift.size == pytest.approx(0.5 / each * math.sqrt(2.0 * gain / level))
    shift.restart([1.0, -2.0, 3.0])
    assert shift.size == 0.0
    shift.learn([1.0 + 2e-3, -2.0 - 1e-3, 3.0], STILL, NEVER_BLIND)  # axes add up in squares
    assert shift.size == pytest.approx(math.sqrt(2.0 * 2.0 * gain))


def test_the_mean_of_the_bias_follows_with_its_time_constant():
    shift, sizes = Shift((1e-3, 1e-3, 1e-3), 1.0, 0.01), []
    for _ in range(101):
        shift.learn([1.0, 0.0, 0.0], STILL, NEVER_BLIND)
        sizes.append(shift.size)
    assert sizes[100] / sizes[0] == pytest.approx(0.99**100)
    at_once = Shift((1e-3, 1e-3, 1e-3), 0.001, 0.01)  # a mean shorter than a sample is the bias itself
    at_once.learn([1.0, 0.0, 0.0], STILL, NEVER_BLIND)
    at_once.learn([1.0, 0.0, 0.0], STILL, NEVER_BLIND)
    assert at_once.size == 0.0


def test_an_axis_of_which_nothing_is_told_takes_its_mean_along_and_does_not_shift():
    shift = Shift((1e-3, 1e-3, 1e-3), 1.0, 0.01)
    shift.learn([1.0, 0.0, 0.0], STILL, (True, False, False))
    assert shift.size == 0.0
    shift.learn([1.0, 0.0, 0.0], STILL, NEVER_BLIND)
    assert shift.size == 0.0
    shift.learn([1.0, 0.5, 0.0], STILL, (True, False, False))
    assert shift.size > 0.0


TIMES = replace(PLAIN, open_after=0.03, open_time=1.0, alarm_hold=0.3, watch=2.0, recall=0.1)


def test_what_the_time_after_an_alarm_counts_as_changes_at_its_sample():
    opening, after = Opening(TIMES, DT), {}
    opening.begin()
    assert opening.pending  # in the sample of the alarm too
    for k in range(1, 700):
        opening.step()
        for name in ("pending", "opens", "under_way", "closes", "closed", "searching", "calm", "may_begin"):
            if getattr(opening, name):
                after.setdefault(name, []).append(k)
    spans = {name: (samples[0], samples[-1]) for name, samples in after.items()}
    assert spans == {
        "pending": (1, 2), "opens": (3, 3), "under_way": (1, 102), "closes": (103, 103), "closed": (104, 699),
        "searching": (3, 199), "calm": (604, 699), "may_begin": (31, 699),
    }  # fmt: skip


def test_before_the_first_alarm_nothing_is_under_way_and_one_may_begin_at_once():
    opening = Opening(TIMES, DT)
    opening.begin()
    opening.reset()
    opening.step()
    assert not any((opening.pending, opening.under_way, opening.opens, opening.closes, opening.searching))
    assert opening.may_begin
    assert opening.closed
    assert not opening.again
    opening.begin()
    assert not opening.again


def test_an_alarm_before_the_filters_have_closed_comes_again():
    opening = Opening(TIMES, DT)
    for samples, again in ((102, True), (103, False), (104, False)):
        opening.reset()
        opening.begin()
        for _ in range(samples):
            opening.step()
        opening.begin()
        assert opening.again is again
    opening.begin()
    opening.step()
    opening.reset()
    assert not opening.again


def test_an_opening_that_is_cut_short_is_over_and_closes_no_more():
    opening = Opening(TIMES, DT)
    opening.begin()
    opening.step()
    opening.cut_short()
    assert not opening.under_way
    opening.step()
    assert opening.closed
    assert not opening.closes


def test_what_is_recalled_was_known_so_long_before():
    past = Recollection(TIMES, DT)
    for k in range(250):
        past.keep(np.full(N, float(k)), np.full(3, -float(k)), False)
    expected = np.full(N, 240.0)
    expected[LAMBDA] *= -1.0
    np.testing.assert_array_equal(past.before(), expected)
    past.recall(True)
    np.testing.assert_array_equal(past.recalled, expected)
    assert (past.long_ago[0], past.settled[0]) == (150.0, -150.0)
    past.keep(np.zeros(N), np.zeros(3), False)
    assert past.recalled[0] == 240.0  # a copy, not a view


def test_at_the_start_of_a_flight_a_healthy_aircraft_is_recalled():
    past = Recollection(TIMES, DT)
    past.keep(np.full(N, 7.0), np.full(3, 7.0), False)
    past.recall(True)
    past.reset()
    healthy = np.zeros(N)
    healthy[LAMBDA] = 1.0
    np.testing.assert_array_equal(past.before(), healthy)
    past.recall(False)
    np.testing.assert_array_equal(past.long_ago, healthy)


def test_filters_open_a_sample_after_the_alarm_at_the_soonest_and_close_one_after_that():
    opening = Opening(replace(TIMES, open_after=1e-4, open_time=1e-4), DT)
    opening.begin()
    opening.step()
    assert opening.opens
    opening.step()
    assert opening.closes
