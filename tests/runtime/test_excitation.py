"""Excitation on demand: when a surface is moved only to see what it does, how, and what is gained."""

import itertools

import numpy as np
import pytest
from msgspec.structs import replace

from runtime.excitation import Excitation
from runtime.presets import PRESETS
from runtime.structured import Effectiveness
from task.limits import DEFLECTION_LIMIT, DT
from tests.runtime.rate_aircraft import MODEL, SETTINGS, Aircraft

SIZE = SETTINGS.excitation
LONG = round(SETTINGS.excitation_time / DT)
AT_LIMIT = np.array([-DEFLECTION_LIMIT, 0.0, 0.0])


class Found:
    """What the excitation asks of who knows the surfaces."""

    def __init__(self, *sd):
        self.searching, self.sd = True, np.array(sd)
        self.near_stall, self.believed = False, np.ones(3)


def asked(excitation, action, samples):
    """Return what becomes of one action over some samples (n, 3)."""
    return np.array([excitation.add(np.array(action)) for _ in range(samples)])


def test_a_surface_at_its_limit_gets_pulses_towards_the_middle_with_rests_between():
    excitation = Excitation(SETTINGS, Found(0.5, 0.5, 0.5))
    out = asked(excitation, AT_LIMIT, 60)
    np.testing.assert_array_equal(out[:, 1:], 0.0)
    pulse = out[:, 0] > -DEFLECTION_LIMIT
    np.testing.assert_allclose(out[pulse, 0], SIZE - DEFLECTION_LIMIT)
    begins = np.flatnonzero(np.diff(pulse.astype(int)) == 1) + 1
    rest = round(Excitation.REST / DT)
    assert begins[0] == Excitation.STILL - 1
    np.testing.assert_array_equal(np.diff(begins), LONG + rest)
    assert all(pulse[b : b + LONG].all() and not pulse[b + LONG : b + LONG + rest].any() for b in begins[:-1])
    assert excitation.pulses == len(begins)


def test_one_surface_at_a_time_the_elevator_first():
    excitation = Excitation(SETTINGS, Found(0.2, 1.0, 1.0))
    limit = DEFLECTION_LIMIT * np.array([1.0, -1.0, 1.0])
    moved, told = [], []
    for _ in range(4 * LONG):
        moved.append(np.abs(excitation.add(limit)) < DEFLECTION_LIMIT)
        told.append(excitation.surface)
    moved = np.array(moved)
    assert (moved.sum(axis=1) <= 1).all()
    assert list(dict.fromkeys(np.flatnonzero(m)[0] for m in moved if m.any())) == [0, 1, 2]
    assert [np.flatnonzero(m)[0] if m.any() else -1 for m in moved] == told


@pytest.mark.parametrize(
    ("why", "settings", "found", "action"),
    [
        ("known well", SETTINGS, Found(0.09, 1.0, 1.0), AT_LIMIT),
        ("not at its limit", SETTINGS, Found(1.0, 1.0, 1.0), 0.9 * AT_LIMIT),
        ("not asked for", replace(SETTINGS, excitation=0.0), Found(1.0, 1.0, 1.0), AT_LIMIT),
        ("nobody to learn from it", SETTINGS, None, AT_LIMIT),
        ("no number", SETTINGS, Found(1.0, 1.0, 1.0), np.full(3, np.nan)),
    ],
)
def test_otherwise_what_is_asked_for_stays_as_it_is(why, settings, found, action):
    np.testing.assert_array_equal(asked(Excitation(settings, found), action, 40), np.tile(action, (40, 1)), why)


@pytest.mark.parametrize(("command", "effect"), [(1.0, 1.0), (-1.0, -1.0)])
def test_near_the_stall_an_elevator_that_holds_the_nose_down_is_left_alone(command, effect):
    found, limit = Found(1.0, 0.0, 0.0), DEFLECTION_LIMIT * np.array([command, 0.0, 0.0])
    found.believed[0], found.near_stall = effect, True
    np.testing.assert_array_equal(asked(Excitation(SETTINGS, found), limit, 40), np.tile(limit, (40, 1)))
    found.believed[0] *= -1.0
    assert asked(Excitation(SETTINGS, found), limit, 40).std() > 0.0
    found.believed[0], found.near_stall = effect, False
    assert asked(Excitation(SETTINGS, found), limit, 40).std() > 0.0


def test_without_an_alarm_there_is_no_pulse():
    found = Found(1.0, 1.0, 1.0)
    found.searching = False
    excitation = Excitation(SETTINGS, found)
    np.testing.assert_array_equal(asked(excitation, AT_LIMIT, 40), np.tile(AT_LIMIT, (40, 1)))
    assert Excitation(PRESETS["understudy"], found).add(AT_LIMIT) is AT_LIMIT


@pytest.mark.parametrize(("searching", "rest"), [(False, Excitation.REST_DEAD), (True, Excitation.REST)])
def test_a_surface_that_is_believed_to_do_nothing_gets_pulses_without_an_alarm_and_rests_longer(searching, rest):
    found = Found(0.5, 0.0, 0.0)
    found.searching, found.believed[0] = searching, 0.0
    excitation = Excitation(SETTINGS, found)
    out = asked(excitation, AT_LIMIT, 200)
    begins = np.flatnonzero(np.diff((out[:, 0] > -DEFLECTION_LIMIT).astype(int)) == 1) + 1
    assert begins[0] == Excitation.STILL - 1
    np.testing.assert_array_equal(np.diff(begins), LONG + round(rest / DT))
    np.testing.assert_array_equal(asked(excitation, 0.9 * AT_LIMIT, 40)[LONG:], np.tile(0.9 * AT_LIMIT, (40 - LONG, 1)))


def test_a_command_that_leaves_its_limit_is_taken_to_the_middle_at_most():
    excitation = Excitation(SETTINGS, Found(1.0, 1.0, 1.0))
    asked(excitation, AT_LIMIT, Excitation.STILL)
    small = np.array([0.4 * SIZE, 0.02, 0.0])
    np.testing.assert_array_equal(excitation.add(small), [0.0, 0.02, 0.0])
    np.testing.assert_array_equal(small, [0.4 * SIZE, 0.02, 0.0])
    assert np.isnan(excitation.add(np.array([np.nan, 0.0, 0.0]))[0])


def reversed_at_its_limit(settings, noise):
    """Return what is known 0.3 s after the elevator has reversed while it stood at its limit: lambda, its sd."""
    aircraft, found = Aircraft(noise=noise), Effectiveness(settings, MODEL, 1)
    excitation, gentle = Excitation(settings, found), aircraft.command
    for k in range(630):
        if k == 600:
            aircraft.effect[0] = -1.0
        found.observe(aircraft.read())
        u = gentle()
        if k > 560:
            u[0] = -DEFLECTION_LIMIT
        u = excitation.add(u)
        found.command(u)
        aircraft.step(u)
    return found.effectiveness[0], found.sd[0], found.believed[0]


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
def test_a_surface_that_reverses_at_its_limit_is_known_by_its_pulse(noise):
    found, sd, believed = reversed_at_its_limit(SETTINGS, noise)
    assert found == pytest.approx(-1.0, abs=0.25)
    assert believed < -0.5
    plain, unsure, _ = reversed_at_its_limit(replace(SETTINGS, excitation=0.0), noise)
    assert unsure > 2.0 * sd
    assert abs(plain + 1.0) > abs(found + 1.0)


def test_a_pulse_takes_5_samples_at_the_limit_in_a_row_on_either_side():
    for sign in (1.0, -1.0):
        excitation = Excitation(SETTINGS, Found(1.0, 0.0, 0.0))
        for near in (0.981, 0.979):
            asked(excitation, 0.5 * AT_LIMIT, 50)
            before = excitation.pulses
            asked(excitation, sign * near * AT_LIMIT, 4)
            asked(excitation, 0.5 * AT_LIMIT, 1)
            asked(excitation, sign * near * AT_LIMIT, 4)
            assert excitation.pulses == before
            asked(excitation, sign * near * AT_LIMIT, 1)
            assert excitation.pulses == before + (near > Excitation.AT_LIMIT)


def test_a_pulse_on_the_positive_side_goes_down_towards_the_middle():
    out = asked(Excitation(SETTINGS, Found(1.0, 0.0, 0.0)), -AT_LIMIT, 10)
    assert out[:, 0].min() == pytest.approx(DEFLECTION_LIMIT - SIZE)
    assert out[:, 0].max() == DEFLECTION_LIMIT


def test_a_command_beyond_its_limit_is_pulsed_from_the_limit():
    out = asked(Excitation(SETTINGS, Found(1.0, 0.0, 0.0)), 3.0 * AT_LIMIT, 10)
    assert out[:, 0].max() == pytest.approx(SIZE - DEFLECTION_LIMIT)


def test_a_surface_is_unsure_beyond_excitation_sd_and_each_rests_by_itself():
    unsure = SETTINGS.excitation_sd
    for sd, pulses in ((unsure, 0), (1.001 * unsure, 1)):
        excitation = Excitation(SETTINGS, Found(sd, 0.0, 0.0))
        asked(excitation, AT_LIMIT, 10)
        assert excitation.pulses == pulses
    excitation, moved = Excitation(SETTINGS, Found(1.0, 1.0, 0.0)), []
    for _ in range(4 * LONG):
        excitation.add(DEFLECTION_LIMIT * np.array([1.0, 1.0, 0.0]))
        moved.append(excitation.surface)
    runs = [(surface, len(list(run))) for surface, run in itertools.groupby(moved)]
    assert runs[:4] == [(-1, Excitation.STILL - 1), (0, LONG), (1, LONG), (0, LONG)]


def test_a_dead_surface_of_a_cast_that_searches_rests_long_only_while_it_is_sure():
    found = Found(0.01, 0.0, 0.0)
    found.believed[0] = 0.0
    excitation = Excitation(SETTINGS, found)
    out = asked(excitation, AT_LIMIT, 200)
    begins = np.flatnonzero(np.diff((out[:, 0] > -DEFLECTION_LIMIT).astype(int)) == 1) + 1
    np.testing.assert_array_equal(np.diff(begins), LONG + round(Excitation.REST_DEAD / DT))
