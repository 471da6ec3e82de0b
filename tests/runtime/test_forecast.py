"""Predicted returns over several imaginations: their mean with forgetting, and what starts it anew."""

import math

import numpy as np
import pytest

from runtime.forecast import SAME, Forecast, belief
from runtime.structured import Effectiveness
from tests.runtime.rate_aircraft import MODEL, SETTINGS

HEALTHY = np.ones(3), 0


def told(*returns):
    return np.array(returns, dtype=np.float32)


def test_the_mean_forgets_with_its_time_constant():
    forecast = Forecast()
    first = forecast.take(told(-10.0, -20.0), 1.0, HEALTHY, 0.5)
    assert first.tolist() == [-10.0, -20.0]
    share = 1.0 - math.exp(-0.2 / 0.5)
    second = forecast.take(told(-20.0, -10.0), 1.2, HEALTHY, 0.5)
    assert second == pytest.approx([-10.0 - 10.0 * share, -20.0 + 10.0 * share])
    third = forecast.take(told(0.0, 0.0), 1.5, HEALTHY, 0.5)  # time counts from the last one
    assert third == pytest.approx(second * math.exp(-0.3 / 0.5))


def test_without_memory_each_imagination_stands_for_itself():
    forecast = Forecast()
    forecast.take(told(-10.0), 0.0, HEALTHY, 0.0)
    assert forecast.take(told(-2.0), 0.001, HEALTHY, 0.0).tolist() == [-2.0]


@pytest.mark.parametrize(
    ("of", "same"),
    [
        ((np.ones(3), 0), True),
        ((np.array([1.0, 0.95, 1.05]), 0), True),
        ((np.array([1.0, 1.0, 1.0 - 1.01 * SAME]), 0), False),
        ((np.array([1.0 + 1.01 * SAME, 1.0, 1.0]), 0), False),
        ((np.ones(3), 1), False),
        (None, False),
    ],
)
def test_another_belief_about_the_aircraft_starts_anew(of, same):
    forecast = Forecast()
    forecast.take(told(-10.0), 0.0, HEALTHY, 1.0)
    mean = forecast.take(told(-2.0), 0.1, of, 1.0)
    assert (mean.item() == -2.0) is not same
    # it is compared with the belief that the mean began with: a slow drift starts anew as well
    drifted = forecast.take(told(-5.0), 0.2, (np.array([1.0, 1.0, 1.0 + 1.04 * SAME]), 0), 1.0)
    assert drifted.item() == -5.0


def test_without_filters_all_imaginations_are_about_the_same_aircraft():
    forecast = Forecast()
    forecast.take(told(-10.0), 0.0, None, 1.0)
    assert forecast.take(told(-2.0), 0.5, None, 1.0).item() == pytest.approx(-10.0 + 8.0 * (1.0 - math.exp(-0.5)))


def test_a_return_that_was_no_number_is_replaced_by_the_next_one():
    forecast = Forecast()
    forecast.take(told(math.nan, -math.inf, -4.0), 0.0, HEALTHY, 1.0)
    with np.errstate(invalid="ignore"):  # as in flight
        mean = forecast.take(told(-1.0, -2.0, -4.0), 0.1, HEALTHY, 1.0)
    assert mean.tolist() == [-1.0, -2.0, -4.0]


def test_after_a_switch_the_incumbent_s_mean_is_the_member_s():
    forecast = Forecast()
    forecast.follow(1)  # nothing is known yet
    forecast.take(told(-1.0, -2.0, -9.0), 0.0, HEALTHY, 1.0)
    forecast.follow(1)
    mean = forecast.take(told(-1.0, -2.0, -2.0), 0.1, HEALTHY, 1.0)
    assert mean.tolist() == [-1.0, -2.0, -2.0]


def test_what_is_forgotten_leaves_no_mean():
    forecast = Forecast()
    forecast.take(told(-10.0), 0.0, HEALTHY, 1.0)
    forecast.reset()
    assert forecast.take(told(-2.0), 0.1, HEALTHY, 1.0).item() == -2.0


def test_what_is_told_is_not_changed():
    forecast, returns = Forecast(), told(-1.0, -2.0)
    forecast.take(returns, 0.0, HEALTHY, 1.0)
    forecast.follow(0)
    assert returns.tolist() == [-1.0, -2.0]


def test_a_belief_is_a_copy_of_what_is_imagined_of_the_surfaces():
    assert belief(None) is None
    found = Effectiveness(SETTINGS, MODEL, 1)
    effect, hypothesis = belief(found)
    assert (effect.tolist(), hypothesis) == ([1.0, 1.0, 1.0], 0)
    found.believed[0] = -1.0
    assert effect[0] == 1.0
