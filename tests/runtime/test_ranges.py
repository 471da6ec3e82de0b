"""Surfaces that stop short of their commands."""

import numpy as np
import pytest
from msgspec.structs import replace

from runtime.hypotheses import hypotheses
from runtime.opening import Opening
from runtime.ranges import Ranges
from runtime.structured import Effectiveness
from task.actuators import HEALTHY
from task.limits import DT
from task.rates import RateModel
from tests.runtime.rate_aircraft import DRIFT, EFFECT, MODEL, SETTINGS, Aircraft, watch


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
@pytest.mark.parametrize("surface", [0, 1, 2])
def test_a_surface_that_stops_short_is_found_with_both_ends_of_its_range(noise, surface):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    trim = (-0.02, 0.0, 0.0)[surface]
    watch(found, aircraft, 500)
    assert found.limited is None
    ends = trim - 0.012, trim + 0.015
    aircraft.low[surface], aircraft.high[surface] = ends
    gentle = aircraft.command
    aircraft.command = lambda: 2.5 * gentle()
    alarms = watch(found, aircraft, 400)
    assert found.limited == surface
    assert len(alarms) == 2  # the surprise, and what is believed then
    np.testing.assert_allclose(found.actuators[:2, surface], ends, atol=0.001)
    others = [i for i in range(3) if i != surface]
    np.testing.assert_array_equal(found.actuators[:2, others], HEALTHY[:2, others])
    np.testing.assert_allclose(found.mixing, np.eye(3), atol=0.1)
    np.testing.assert_allclose(found.effectiveness, 1.0, atol=0.1)
    # What acts is known, and nothing surprises any more.
    assert watch(found, aircraft, 300) == []
    command = 0.1 * np.ones(3)
    found.command(command)
    expected = command.copy()
    expected[surface] = found.actuators[1, surface]
    np.testing.assert_allclose(found.followed()[-1], expected)
    # Whole again: it is seen to follow.
    aircraft.low[surface], aircraft.high[surface] = -np.inf, np.inf
    assert watch(found, aircraft, 400)
    low, high = found.actuators[:2, surface]
    assert found.limited is None or (low < trim - 0.03 and high > trim + 0.03)


def test_the_end_is_found_also_where_the_surface_moves_the_aircraft_little():
    """An elevator at low speed: a moment that was there before could be as much of it."""
    aircraft, found = Aircraft(), Effectiveness(SETTINGS, RateModel(DRIFT, 0.44 * EFFECT), 1)
    aircraft.effect = np.full(3, 0.44)
    watch(found, aircraft, 500)
    aircraft.low[0] = -0.04
    aircraft.command = lambda: np.array([-0.1, 0.0, 0.0])
    watch(found, aircraft, 200)
    assert found.limited == 0
    np.testing.assert_allclose(found.actuators[0, 0], -0.04, atol=0.001)
    np.testing.assert_allclose(found.effectiveness, 1.0, atol=0.1)


@pytest.mark.parametrize("at", [0.01, 0.26, -0.26])
def test_a_jammed_surface_has_both_ends_at_one_place_or_is_dead(at):
    """Also where it ran away to, beyond all that can be commanded."""
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.low[1] = aircraft.high[1] = at
    watch(found, aircraft, 500)
    low, high = found.actuators[:2, 1]
    dead = found.limited is None and abs(found.believed[1]) < 0.15
    assert dead or (found.limited == 1 and low == pytest.approx(at, abs=Ranges.SURE) and low <= high < low + 0.01)


@pytest.mark.parametrize("effect", [(-1.0, 1.0, 1.0), (1.0, -0.3, 1.0), (0.3, 1.0, 1.0), (-1.0, -1.0, 1.0)])
def test_a_surface_that_works_otherwise_is_not_taken_for_one_that_stops_short(effect):
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.effect = np.array(effect)
    watch(found, aircraft, 100)
    assert found.limited is None
    np.testing.assert_allclose(found.believed, effect, atol=0.3)


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
@pytest.mark.parametrize("other", [1, 2])
def test_a_range_that_is_known_stays_known_when_another_surface_changes(noise, other):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.low[0], aircraft.high[0] = -0.03, -0.01
    watch(found, aircraft, 400)
    assert found.limited == 0
    aircraft.effect[other] = -1.0
    assert watch(found, aircraft, 150)
    assert found.limited == 0
    np.testing.assert_allclose(found.actuators[:2, 0], (-0.03, -0.01), atol=0.001)
    np.testing.assert_allclose(found.effectiveness, aircraft.effect, atol=0.2)
    # Whole again: what was known is given up.
    aircraft.low[0], aircraft.high[0] = -np.inf, np.inf
    watch(found, aircraft, 400)
    low, high = found.actuators[:2, 0]
    assert found.limited is None or (low < -0.05 and high > 0.01)


def test_a_range_is_known_once_the_filters_have_closed_since_it_was_found():
    """What is believed for some samples may be wrong, and an open filter that keeps it explains whatever comes."""
    opening = Opening(SETTINGS, DT)
    for samples, again in ((10, False), (50, True), (300, True), (0, False)):
        opening.begin()
        assert opening.again == again
        for _ in range(samples):
            opening.step()
    aircraft, found = Aircraft(), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.low[0], aircraft.high[0] = -0.03, -0.01
    watch(found, aircraft, 400)
    elevator, command = found.ranges.of[0], [0.0] * 3
    found.ranges.open(command, [1.0] * 3, 0, True)
    assert (elevator.limited, elevator.sought) == (True, False)
    found.ranges.open(command, [1.0] * 3, 0, False)
    assert (elevator.limited, elevator.sought) == (False, True)


def test_ranges_are_looked_for_on_request_only():
    names = [h.limited for h in hypotheses(replace(SETTINGS, delays=(0.05,), rate_limits=(0.1,)), DT)]
    assert names == [None] * 7 + [0, 1, 2]
    assert all(h.limited is None for h in hypotheses(replace(SETTINGS, ranges=False), DT))
    found = Effectiveness(replace(SETTINGS, ranges=False), MODEL, 1)
    assert found.ranges is None
    aircraft = Aircraft()
    watch(found, aircraft, 300)
    aircraft.low[0], aircraft.high[0] = -0.03, -0.01
    assert watch(found, aircraft, 200)
    np.testing.assert_array_equal(found.actuators[:2], HEALTHY[:2])
