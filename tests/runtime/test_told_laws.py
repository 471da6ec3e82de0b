"""What laws make of what they are told: late, slow and crossed commands, and surfaces that work the other way round."""

import math

import numpy as np
import pytest

from runtime.hypotheses import CROSSED, STRAIGHT
from runtime.laws.catalogue import make_law
from task.actuators import ACTUATOR, HEALTHY, limited
from task.metrics import nmae
from task.observation import tracking_error
from task.reference import random_reference
from task.state import ACTION, REFERENCE
from tests.runtime.law_flights import ROWS, SETTINGS, flight, reversed_by_now, reversed_elevator


@pytest.mark.parametrize("name", ["indi", "indi-rls-signfree"])
def test_late_commands_are_flown_by_an_indi_that_knows(name):
    def late(tick, sent):
        return sent[max(len(sent) - 16, 0)] if tick >= 500 else sent[-1]

    def tell(tick, law):
        law.match(15 if tick >= 500 else 0, STRAIGHT)

    known = flight(make_law(name, SETTINGS), 3000, late, tell)
    assert len(known) == 3001
    error = nmae(tracking_error(known[1:], ROWS[:3000]))
    assert error < 8.0
    unknown = flight(make_law(name, SETTINGS), 3000, late)
    assert len(unknown) < 3001 or nmae(tracking_error(unknown[1:], ROWS[:3000])) > 3.0 * error


def slow_flight(ticks, rows, knows):
    """Fly an INDI whose surfaces move no faster than 4 deg/s from 5 s on, and that is told so or not."""
    rate, acting = np.radians(4.0), [np.zeros(3)]
    slow = HEALTHY.copy()
    slow[ACTUATOR.rate] = rate

    def slowed(tick, sent):
        acting.append(limited(sent[-1], acting[-1], slow) if tick >= 500 else sent[-1])
        return acting[-1]

    def tell(tick, law):
        law.match(0, STRAIGHT, rate if knows and tick >= 500 else np.inf)

    return flight(make_law("indi-rls-signfree", SETTINGS), ticks, slowed, tell, hears=knows, rows=rows)


def test_slow_surfaces_are_flown_by_an_indi_that_knows():
    rows = random_reference(np.random.default_rng(3), 30.0, 0.0, "aggressive")
    rows[:, REFERENCE.theta] += ROWS[0, REFERENCE.theta]
    known = slow_flight(2900, rows, True)
    assert len(known) == 2901
    assert nmae(tracking_error(known[1:], rows[:2900])) < 60.0
    assert len(slow_flight(2900, rows, False)) < 2901


def test_slow_surfaces_do_not_slow_an_indi_that_asks_little_of_them():
    error = [nmae(tracking_error(slow_flight(3000, ROWS, knows)[1000:], ROWS[999:3000])) for knows in (True, False)]
    assert error[0] < 0.5
    assert error[0] < 4.0 * error[1]


def test_crossed_surfaces_are_flown_by_an_indi_that_knows():
    def crossed(tick, sent):
        return sent[-1][list(CROSSED)] if tick >= 500 else sent[-1]

    def tell(tick, law):
        law.match(0, CROSSED if tick >= 505 else STRAIGHT)

    known = flight(make_law("indi-rls-signfree", SETTINGS), 3000, crossed, tell)
    assert len(known) == 3001
    assert nmae(tracking_error(known[1:], ROWS[:3000])) < 3.0
    assert len(flight(make_law("indi", SETTINGS), 3000, crossed)) < 3001


def goes_by(law):
    return np.array([math.nan if told is None else told for told in law._told])


def test_an_indi_that_is_told_of_a_reversal_flies_on_and_later_goes_by_what_it_finds_itself():
    informed = []

    def tell(tick, law):
        reversed_by_now(tick, law)
        informed.append(not np.isnan(goes_by(law)[ACTION.de]))

    told = flight(make_law("indi-rls-signfree", SETTINGS), 3000, reversed_elevator, tell)
    untold = flight(make_law("indi-rls-signfree", SETTINGS), 3000, reversed_elevator)
    assert len(told) == len(untold) == 3001

    def error(states):
        return nmae(tracking_error(states[501:1000], ROWS[500:999]))

    assert error(told) < 0.7 * error(untold)
    found = np.flatnonzero(informed)
    assert found[0] == 515
    assert 520 < found[-1] < 700
    # one that finds nothing itself goes by it for good
    assert len(flight(make_law("indi", SETTINGS), 3000, reversed_elevator)) < 3001
    assert len(flight(make_law("indi", SETTINGS), 3000, reversed_elevator, reversed_by_now)) == 3001


def test_what_counts_of_what_an_indi_is_told_is_a_sign_that_it_has_not_found():
    law = make_law("indi-rls-signfree", SETTINGS)
    law.estimate.multipliers[:] = [0.5, -0.2, -1.0]
    for sure, expected in (
        ([0.9, 0.7, -0.4], [math.nan, 0.7, math.nan]),
        ([-0.9, None, 0.4], [-0.9, math.nan, 0.4]),
        ([None, None, None], [math.nan] * 3),
    ):
        law.inform(sure, True)
        np.testing.assert_array_equal(goes_by(law), expected)


def test_without_news_an_indi_is_told_what_has_turned_round_and_not_what_is_known_as_it_was():
    law = make_law("indi-rls-signfree", SETTINGS)
    sure = [1.0, 1.0, 1.0]
    for elevator in (1.0, None, -1.0, -0.8):
        sure[ACTION.de] = elevator
        law.inform(sure, False)
    np.testing.assert_array_equal(goes_by(law), [-0.8, math.nan, math.nan])
    # It finds the same itself; then the elevator is repaired, which only the law has seen.
    for found in (-1.0, 1.0):
        law.estimate.multipliers[ACTION.de] = found
        law.inform(sure, False)
        assert np.isnan(goes_by(law)).all()
