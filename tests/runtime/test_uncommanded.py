"""Surfaces that move besides by themselves."""

import numpy as np
import pytest
from msgspec.structs import replace

from runtime.hypotheses import Evidence, hypotheses
from runtime.opening import Recollection
from runtime.rate_filter import MOTION, N
from runtime.structured import Effectiveness
from runtime.uncommanded import PLACES, SLOPE, UNIT
from task.limits import DT
from task.state import STATE
from tests.runtime.rate_aircraft import MODEL, SETTINGS, Aircraft, watch


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
@pytest.mark.parametrize(("surface", "hz"), [(0, 1.0), (1, 1.5), (2, 0.5)])
def test_a_surface_that_oscillates_works_as_it_did(noise, surface, hz):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    aircraft.effect[surface] = 0.7
    watch(found, aircraft, 500)
    before = found.believed.copy()
    aircraft.swing[surface], aircraft.hz = 0.035, hz
    watch(found, aircraft, 150)
    assert found.uncommanded == surface
    of = []
    for _ in range(round(1.0 / (hz * DT))):
        of.append((UNIT * found.filter.s[found.evidence.believed, PLACES[surface]], aircraft.moved()[surface]))
        watch(found, aircraft, 1)
    motion, true = (np.array(of) - np.mean(of, axis=0)).T  # a constant part may as well be the bias
    assert np.corrcoef(motion, true)[0, 1] > 0.97
    assert np.ptp(motion) == pytest.approx(np.ptp(true), rel=0.25)
    np.testing.assert_allclose(found.believed, before, atol=0.15)
    np.testing.assert_allclose(found.effectiveness, before, atol=0.2)
    assert found.delay_samples == 0
    # Nothing surprises any more, and what surfaces do is still found.
    assert watch(found, aircraft, 500) == []
    assert found.alarm.shift.size == 0.0  # how d and the bias share what lasts is no news
    other = (surface + 1) % 3
    aircraft.effect[other] = -1.0
    assert watch(found, aircraft, 100)
    assert found.believed[other] == pytest.approx(-1.0, abs=0.3)


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
def test_a_surface_that_oscillated_and_works_backwards_is_found_to(noise):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.swing[1], aircraft.hz = 0.035, 1.3
    watch(found, aircraft, 300)
    assert found.uncommanded == 1
    aircraft.swing[1] = 0.0
    watch(found, aircraft, 300)
    gentle = aircraft.command
    aircraft.command = lambda: 3.0 * gentle()
    aircraft.effect[1] = -1.0
    assert watch(found, aircraft, 100)
    watch(found, aircraft, 50)
    assert found.uncommanded is None
    assert found.believed[1] == pytest.approx(-1.0, abs=0.3)


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
@pytest.mark.parametrize("effect", [(-1.0, 1.0, 1.0), (1.0, -0.3, 1.0), (0.3, 1.0, 1.0), (-1.0, -1.0, 1.0)])
def test_a_surface_that_works_otherwise_is_not_taken_for_one_that_moves_by_itself(noise, effect):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.effect = np.array(effect)
    for _ in range(30):
        watch(found, aircraft, 10)
        assert found.uncommanded is None
    np.testing.assert_allclose(found.believed, effect, atol=0.3)


@pytest.mark.parametrize("elevator", [1.0, 0.3])
def test_what_turbulence_does_is_no_surface_that_moves(elevator):
    """Neither in quiet flight nor when another surface opens the filters: gusts go on as a motion does."""
    aircraft, found = Aircraft(), Effectiveness(SETTINGS, MODEL, 1)
    rng, step, gust = np.random.default_rng(2), aircraft.step, np.zeros((2, 3))

    def shaken(u):
        step(u)
        gust[0] += 0.05 * (10.0 * rng.standard_normal(3) * (1.0, 0.1, 0.1) - gust[0])
        gust[1] += 0.05 * (gust[0] - gust[1])
        aircraft.w = aircraft.w + DT * gust[1]

    aircraft.step = shaken
    watch(found, aircraft, 800)
    aircraft.effect[0] = elevator
    for _ in range(120):
        watch(found, aircraft, 10)
        assert found.uncommanded is None
    assert (found.alarms > 0) == (elevator < 1.0)


def test_nothing_but_the_motion_is_looked_for():
    """A slope would take part of the motion, and be wrong by the time the angle of attack is another one."""
    aircraft, found = Aircraft(), Effectiveness(SETTINGS, MODEL, 1)
    read, step = aircraft.read, aircraft.step

    def waving():
        x = read()
        x[STATE.alpha] += 0.05 * np.sin(2.0 * aircraft.tick * DT)
        return x

    def unstable(u):
        step(u)
        aircraft.w[1] += DT * 2.0 * 0.05 * np.sin(2.0 * aircraft.tick * DT)

    aircraft.read = waving
    watch(found, aircraft, 500)
    aircraft.step, aircraft.swing[0] = unstable, 0.035
    watch(found, aircraft, 150)
    slopes = dict(zip(found.hypotheses, found.filter.s[:, SLOPE], strict=False))
    assert {found.hypotheses[0].uncommanded, *(h.uncommanded for h in slopes)} == {None, 0, 1, 2}
    for choice, slope in slopes.items():
        assert (slope == 0.0) == (choice.uncommanded is not None or choice.limited is not None)


@pytest.mark.parametrize(("odds", "lead"), [(0.0, 10), (5.0, 20)])
def test_what_started_behind_is_given_up_by_twice_the_lead(odds, lead):
    evidence = Evidence([0.0, odds], 1.0, 10.0, 10.0)
    evidence.believed = 1
    evidence.forget()
    told = [evidence.weigh([1.0, 0.0]) for _ in range(30)]
    assert told.index(True) == lead + Evidence.HOLD - 1  # a lead of more than that, held


def test_how_fast_a_surface_moved_is_not_recalled_as_a_slope():
    past, state = Recollection(SETTINGS, DT), np.arange(1.0, N + 1.0)
    for moving in (False, True):
        for _ in range(round(Recollection.LONG_AGO / DT)):
            past.keep(state, np.ones(3), moving)
        past.recall(True)
        expected = np.concatenate([state[:3], np.ones(3), state[6:MOTION], [0.0 if moving else state[MOTION]]])
        np.testing.assert_array_equal(past.long_ago, expected)


def test_between_alarms_that_follow_one_another_nothing_is_settled():
    past, works = Recollection(SETTINGS, DT), np.array([1.0, -1.0, 0.3])
    np.testing.assert_array_equal(past.settled, 1.0)
    for calm, found in ((True, works), (False, np.zeros(3))):
        for _ in range(round(Recollection.LONG_AGO / DT)):
            past.keep(np.zeros(N), found, False)
        past.recall(calm)
        np.testing.assert_array_equal(past.settled, works)
    past.reset()
    np.testing.assert_array_equal(past.settled, 1.0)


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
def test_a_surface_whose_motion_was_countered_works_as_it_did_before_that(noise):
    """Who counters the swing holds the sum of both at rest, as a dead surface does."""
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    aircraft.effect[0] = 0.7
    watch(found, aircraft, 900)
    aircraft.swing[0] = 0.035
    gentle = aircraft.command
    aircraft.command = lambda: gentle() * [0.0, 1.0, 1.0] - 0.8 * aircraft.moved()
    watch(found, aircraft, 200)
    assert (found.uncommanded, found.limited) == (None, None)
    assert found.effectiveness[0] < 0.0
    aircraft.command = gentle
    assert watch(found, aircraft, 100)
    assert found.uncommanded == 0
    assert found.effectiveness[0] == pytest.approx(0.7, abs=0.1)


def test_they_are_looked_for_on_request_only():
    names = [h.uncommanded for h in hypotheses(replace(SETTINGS, delays=(0.05,), rate_limits=(0.1,)), DT)]
    assert names == [None] * 4 + [0, 1, 2] + [None] * 3
    aircraft, found = Aircraft(), Effectiveness(replace(SETTINGS, q_uncommanded=0.0), MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.swing[0] = 0.05
    assert len(watch(found, aircraft, 500)) > 2
    assert found.uncommanded is None
