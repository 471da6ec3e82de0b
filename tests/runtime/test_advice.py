"""What laws are told: how high an angle of attack the elevator holds, and what INDI makes of it."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from msgspec.structs import replace

from runtime.advice import ELEVATOR_FOR_ALPHA, NOSE_UP, STEEPEST, highest_alpha, sure_signs
from runtime.laws.catalogue import load_settings, make_law
from runtime.structured import Effectiveness
from sim_bridge.faults import Icing
from sim_bridge.flight import Flight
from sim_bridge.plant import NOMINAL, Plant
from sim_bridge.world import World
from task.laws import N_MEMORY, SEEN
from task.limits import DEFLECTION_LIMIT, DT
from task.reward import UNSAFE_ALPHA, terminated
from task.state import ACTION, REFERENCE, STATE
from tests.runtime.rate_aircraft import MODEL, SETTINGS, Aircraft, watch

RESERVE = math.radians(2.5)


@dataclass
class Stuck:
    any: bool = False


@dataclass
class Found:
    """What is believed of an aircraft whose elevator holds the nose down with 5 deg."""

    known: bool = True
    alpha: float = 0.05
    elevator_effect: float = -12.5
    nose_up: float = 1.0
    pitching: float = 0.0
    elevator: float = math.radians(5.0)
    stuck: Stuck = field(default_factory=Stuck)

    @property
    def acted(self):
        return np.array([self.elevator, 0.0, 0.0])


def test_what_is_left_of_the_elevator_is_what_the_angle_of_attack_may_grow_by():
    assert ELEVATOR_FOR_ALPHA == 1.0
    assert highest_alpha(Found(), RESERVE) == pytest.approx(0.05 + math.radians(10.0 - 2.5 - 5.0))
    # pitching up already: what stops it is needed as well
    assert highest_alpha(Found(pitching=0.25), RESERVE) == pytest.approx(0.05 + math.radians(2.5) - 0.02)
    falling = Found(alpha=0.1, elevator=DEFLECTION_LIMIT, pitching=3.0)
    assert highest_alpha(falling, RESERVE) == pytest.approx(0.1 - STEEPEST)


def test_a_surface_that_stops_short_is_known_to_work_the_way_it_did():
    """A law that finds nothing at the limit may come to believe the contrary."""
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.effect[ACTION.da] = -1.0
    watch(found, aircraft, 300)
    aircraft.low[ACTION.da], aircraft.high[ACTION.da] = -0.015, 0.015
    gentle = aircraft.command
    aircraft.command = lambda: 2.5 * gentle()
    watch(found, aircraft, 400)
    assert found.limited == ACTION.da
    np.testing.assert_allclose(sure_signs(found, *found.actuators[:2]), (1.0, -1.0, 1.0), atol=0.1)


def test_no_nose_is_held_down_without_end():
    """A stable aircraft needs the more elevator the lower its nose is: what is left shrinks with each limit."""
    alpha = 0.05
    for _ in range(20):
        asked = highest_alpha(Found(alpha=alpha, elevator=DEFLECTION_LIMIT), RESERVE)
        assert asked >= 0.0
        alpha = min(alpha, asked)
    assert alpha == 0.0


@pytest.mark.parametrize(
    ("why", "found", "reserve"),
    [
        ("nothing is to be kept", Found(), 0.0),
        ("the filters do not run", Found(known=False), RESERVE),
        ("a sensor stands still", Found(stuck=Stuck(any=True)), RESERVE),
        ("the elevator is reversed", Found(elevator_effect=12.5), RESERVE),
        ("the elevator is dead", Found(elevator_effect=-0.5), RESERVE),
        ("the moment is that of a healthy aircraft", Found(nose_up=0.9 * 12.5 * NOSE_UP), RESERVE),
        ("the moment is nose down", Found(nose_up=-1.0), RESERVE),
    ],
)
def test_otherwise_any_angle_of_attack_will_do(why, found, reserve):
    assert highest_alpha(found, reserve) == math.inf, why


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
def test_the_filters_find_the_moment_and_what_the_elevator_makes_up_for(noise):
    # Without noise a moment that begins at once is taken for an elevator that moves by itself.
    settings = SETTINGS if noise else replace(SETTINGS, q_uncommanded=0.0)
    aircraft, found = Aircraft(noise=noise), Effectiveness(settings, MODEL, 1)
    assert highest_alpha(found, RESERVE) == math.inf
    watch(found, aircraft, 500)
    assert highest_alpha(found, RESERVE) == math.inf
    effect, moment, step = found.elevator_effect, 2.0, aircraft.step
    quiet = aircraft.command

    def pushed(u):
        step(u)
        aircraft.w[1] += DT * moment

    aircraft.step = pushed
    aircraft.command = lambda: quiet() * [0.2, 1.0, 1.0] - [moment / effect, 0.0, 0.0]
    watch(found, aircraft, 300)
    assert found.nose_up == pytest.approx(moment, abs=0.15)
    held = DEFLECTION_LIMIT - RESERVE + moment / effect
    assert highest_alpha(found, RESERVE) == pytest.approx(found.alpha + held, abs=0.02)


@pytest.mark.parametrize("highest", [math.inf, 0.2, 0.08, 0.0])
def test_an_indi_asks_for_no_pitch_rate_that_goes_beyond_the_angle_of_attack_that_it_was_told(highest):
    law, plant = make_law("indi", load_settings(), DT), Plant()
    x = plant.reset(NOMINAL).copy()
    reference = x[[STATE.theta, STATE.phi, STATE.beta]] + [math.radians(10.0), 0.0, 0.0]
    alphas = []
    for _ in range(300):
        law.limit_alpha(highest, seen=True)
        action = law.steer(x, reference)
        law.sent(action)
        x = plant.step(action).copy()
        alphas.append(x[STATE.alpha])
    assert max(alphas) < max(highest, alphas[0]) + 0.005
    if highest < alphas[0]:
        assert alphas[-1] == pytest.approx(highest, abs=0.01)
    elif highest == math.inf:
        assert max(alphas) > 0.1
        assert x[STATE.theta] == pytest.approx(reference[0], abs=0.01)


def test_an_angle_of_attack_that_stands_still_limits_nothing():
    """Stuck above the limit it would have the nose lowered without end."""
    law, plant = make_law("indi-rls-protected", load_settings(), DT), Plant()
    x = plant.reset(NOMINAL).copy()
    reference = x[[STATE.theta, STATE.phi, STATE.beta]].copy()
    pitch = []
    for seen in (True, False):
        x = plant.reset(NOMINAL).copy()
        law.reset()
        for _ in range(300):
            law.limit_alpha(math.inf, seen)
            x[STATE.alpha] = UNSAFE_ALPHA + 0.05
            action = law.steer(x, reference)
            law.sent(action)
            x = plant.step(action).copy()
        pitch.append(x[STATE.theta] - reference[0])
    assert pitch[0] < -0.1
    assert pitch[1] == pytest.approx(0.0, abs=0.01)


def test_the_protected_law_keeps_an_iced_aircraft_that_the_others_take_into_the_stall():
    flown = []
    for name in ("indi-rls-signfree", "indi-rls-protected"):
        world = World(Flight(duration=30.0, faults=(Icing(start=5.0),)))
        law = make_law(name, load_settings(), DT)
        climb = np.array([0.25, 0.0, 0.0])
        level = world.x[[STATE.theta, STATE.phi, STATE.beta]].copy()
        for k in range(3000):
            rows = level + min(max(0.008 * (k - 700), 0.0), 1.0) * climb
            action = law.steer(world.measured, rows)
            law.sent(action)
            world.step(action)
            if terminated(world.x):
                break
        flown.append((k + 1) * DT)
    assert flown[0] < 30.0
    assert flown[1] == 30.0


def bank_with_little_aileron(told):
    """Return the sideslip (600,) [rad] of an INDI asked to bank by 20 deg with an aileron that ends at 0.5 deg."""
    law, plant = make_law("indi", load_settings(), DT), Plant()
    high = np.array([DEFLECTION_LIMIT, math.radians(0.5), DEFLECTION_LIMIT])
    x = plant.reset(NOMINAL).copy()
    reference = x[[STATE.theta, STATE.phi, STATE.beta]] + [0.0, math.radians(20.0), 0.0]
    sideslip = []
    for _ in range(600):
        if told:
            law.limit_range((-high).tolist(), high.tolist())
        acts = np.clip(law.steer(x, reference), -high, high)
        law.sent(acts)
        x = plant.step(acts).copy()
        sideslip.append(x[STATE.beta])
    return np.array(sideslip)


def test_an_indi_told_where_the_aileron_ends_asks_the_rudder_for_no_part_of_a_roll_that_does_not_come():
    untold, told = map(bank_with_little_aileron, (False, True))
    assert np.abs(untold).mean() > 5.0 * np.abs(told).mean()


@pytest.mark.parametrize(
    ("asked", "at_its_end", "other"),
    [(REFERENCE.phi, ACTION.da, ACTION.dr), (REFERENCE.beta, ACTION.dr, ACTION.da)],
)
def test_an_indi_is_imagined_to_do_without_a_surface_that_is_at_its_end(asked, at_its_end, other):
    law, plant = make_law("indi", load_settings(), DT), Plant()
    x = plant.reset(NOMINAL).copy()
    column, parts = N_MEMORY + SEEN.reference.start + asked, []
    for error in (0.0, 0.0, 1.0):
        reference = x[[STATE.theta, STATE.phi, STATE.beta]]
        reference[asked] += error
        action = law.steer(x, reference)
        law.sent(action)
        parts.append(law.linear().maps[other, column])
    assert abs(action[at_its_end]) == DEFLECTION_LIMIT
    assert parts[1] != 0.0
    assert parts[2] == 0.0
    law.reset()
    for _ in range(2):
        law.sent(law.steer(x, x[[STATE.theta, STATE.phi, STATE.beta]]))
    assert law.linear().maps[other, column] == parts[1]


@dataclass
class Known:
    """What is believed of three surfaces: lambda and how sure."""

    effectiveness: np.ndarray
    sd: np.ndarray


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sign_is_sure_beyond_three_standard_deviations_and_a_tenth(sign):
    found = Known(sign * np.array([0.41, 0.39, 1.0]), np.array([0.1, 0.1, 0.301]))
    assert sure_signs(found, [-0.1] * 3, [0.1] * 3) == [sign * 0.41, None, None]


def test_a_surface_that_cannot_move_by_more_than_a_hundredth_has_no_sign():
    found = Known(np.array([1.0, -1.0, 1.0]), np.full(3, 0.01))
    assert sure_signs(found, [0.02, -0.01, -0.1], [0.0301, 0.0, 0.1]) == [1.0, None, 1.0]


def test_a_moment_counts_from_three_degrees_of_elevator_and_an_elevator_from_what_it_pitches():
    for effect, works in ((-1.001, True), (-0.999, False)):
        assert math.isfinite(highest_alpha(Found(elevator_effect=effect, nose_up=9.0), RESERVE)) is works
    least = 12.5 * math.radians(3.0)
    assert math.isfinite(highest_alpha(Found(nose_up=least + 1e-6), RESERVE))
    assert highest_alpha(Found(nose_up=least - 1e-6), RESERVE) == math.inf


def test_a_nose_that_falls_already_leaves_more_of_the_elevator():
    level, falling = (highest_alpha(Found(pitching=each), RESERVE) for each in (0.0, -0.25))
    assert falling - level == pytest.approx(0.02)


def test_what_cannot_be_held_is_left_no_faster_than_from_three_degrees_away_and_never_below_zero():
    beyond = Found(alpha=0.2, elevator=DEFLECTION_LIMIT, pitching=9.0)
    assert highest_alpha(beyond, RESERVE) == pytest.approx(0.2 - math.radians(3.0))
    beyond.alpha = 0.02
    assert highest_alpha(beyond, RESERVE) == 0.0
