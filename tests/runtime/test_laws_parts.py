"""The pieces of the laws: what they know, what they divide by, what they refuse."""

import math

import numpy as np
import pytest
from click.testing import CliRunner

from runtime.cli import main
from runtime.laws.catalogue import LAWS, SETTINGS, load_settings, load_solo, make_law
from runtime.laws.effectiveness import MOTIONS, Effectiveness
from runtime.laws.law import air_density, attitude_rates
from runtime.laws.pace import Pace
from runtime.laws.slip import BRAKE, CLOSING, HELD, OPENING, RETURN, ROLL, BankHold
from sim_bridge.plant import NOMINAL, R1, R2, Plant
from task.errors import UserError
from task.limits import DEFLECTION_LIMIT, DT
from task.model import kinematic_rates
from task.state import ACTION, N_STATE, REFERENCE, STATE

SETTINGS_OF_LAWS = load_settings()


@pytest.fixture(scope="module")
def plant():
    return Plant()


def test_density_is_the_standard_atmosphere_s():
    for altitude, density in ((0.0, 1.225), (2000.0, 1.0066), (5000.0, 0.7364), (10000.0, 0.4135)):
        assert air_density(max(altitude, 50.0)) == pytest.approx(density, rel=6e-3)


@pytest.mark.parametrize("condition", [NOMINAL, R1, R2], ids=["nominal", "R1", "R2"])
@pytest.mark.parametrize("law", LAWS)
def test_at_trim_every_law_asks_for_trim(law, condition, plant):
    x = plant.reset(condition).copy()
    solo = load_solo(law).law
    reference = x[[STATE.theta, STATE.phi, STATE.beta]]
    for _ in range(3):
        action = solo.steer(x, reference)
        np.testing.assert_allclose(action, plant.trim.action, atol=np.radians(0.02))
        solo.sent(action)


def test_the_effectiveness_that_the_laws_know_is_the_plant_s(plant):
    known = np.array(SETTINGS_OF_LAWS.airframe.effectiveness)
    for surface in ACTION:
        rates = []
        for deflection in (0.01, -0.01):
            plant.reset(NOMINAL)
            action = plant.trim.action.copy()
            action[surface] += deflection
            plant.step(action)
            rates.append(plant.step(action)[: STATE.r + 1].copy())
        np.testing.assert_allclose(known[:, surface], (rates[0] - rates[1]) / (0.02 * 0.01), rtol=0.02, atol=0.02)


def test_the_dihedral_effect_that_the_laws_know_is_the_plant_s(plant):
    x, rates = plant.reset(NOMINAL).copy(), []
    for sideslip in (0.02, -0.02):
        x[STATE.beta] = sideslip
        plant.reset(NOMINAL, x=x)
        rates.append(float(plant.step(plant.trim.action)[STATE.p]))
    assert SETTINGS_OF_LAWS.airframe.dihedral == pytest.approx((rates[0] - rates[1]) / (0.04 * 0.01), rel=0.02)


LEVEL = {"turn": 0.0, "p": 0.0, "p_dot": 0.0, "beta": 0.0, "effect": -10.0}
"""Straight and level, on its reference but for the bank."""
JAMMED = {"right": False, "left": False}


@pytest.mark.parametrize("error", [0.6, -0.6])
@pytest.mark.parametrize("stuck", [True, False])
def test_a_bank_beyond_its_bound_is_taken_back_by_sideslip_where_the_aileron_cannot(error, stuck):
    can = {"right": not stuck or error < 0.0, "left": not stuck or error > 0.0}
    slip = BankHold(0.5, DT).sideslip(error, **LEVEL, **can)
    # sideslip from the left rolls right
    assert slip == pytest.approx(-ROLL * RETURN * 0.1 / 10.0 * np.sign(error) if stuck else 0.0)


def test_no_sideslip_is_asked_for_while_the_bank_stays_within_its_bound():
    hold = BankHold(0.5, DT)
    assert hold.sideslip(0.49, **LEVEL, **JAMMED) == hold.sideslip(-0.49, **LEVEL, **JAMMED) == 0.0
    # nor while it comes back as fast as it need, however the body turns
    assert hold.sideslip(0.7, **LEVEL | {"p": 0.5 * RETURN, "turn": 0.5 * RETURN}, **JAMMED) == 0.0
    # but a roll that leaves too fast is braked, and what holds it is kept
    leaving = BankHold(0.5, DT).sideslip(0.4, **LEVEL | {"p": -0.5}, **JAMMED)
    assert leaving == pytest.approx(-ROLL * (0.5 - BRAKE * 0.1) / 10.0)
    held = LEVEL | {"p": -0.1 * BRAKE, "beta": -0.03}
    assert BankHold(0.5, DT).sideslip(0.4, **held, **JAMMED) == pytest.approx(-0.03)


def test_where_sideslip_must_be_held_anyway_the_bound_closes():
    hold = BankHold(0.5, DT)
    for _ in range(round(CLOSING / DT)):
        assert abs(hold.sideslip(0.5, **LEVEL | {"p": -0.02, "beta": -1.1 * HELD}, **JAMMED)) > HELD
    assert hold.bound == pytest.approx(0.5 / np.e, rel=0.01)
    for _ in range(round(OPENING / DT)):
        assert hold.closed
        assert hold.sideslip(0.0, **LEVEL, **JAMMED) == 0.0
    assert hold.bound == pytest.approx(0.5 - 0.5 * (1.0 - 1.0 / np.e) / np.e, rel=0.01)
    hold.reset()
    assert hold.bound == 0.5
    assert not hold.closed


def test_attitude_rates_are_the_task_s_kinematics():
    x = np.random.default_rng(0).uniform(-0.5, 0.5, N_STATE)
    phi_rate, theta_rate = kinematic_rates(x)[:2]
    assert attitude_rates(x.tolist()) == pytest.approx((theta_rate, phi_rate), abs=1e-12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("axis", list(REFERENCE), ids=lambda r: r.name)
def test_an_error_moves_its_surface_the_right_way(law, axis, plant):
    x = plant.reset(NOMINAL).copy()
    solo = load_solo(law).law
    reference = x[[STATE.theta, STATE.phi, STATE.beta]]
    solo.sent(solo.steer(x, reference))
    wanted = reference.copy()
    wanted[axis] += 0.002
    solo.steer(x, wanted)
    change = (solo.steer(x, wanted) - plant.trim.action)[axis]
    assert change * (-1.0, -1.0, 1.0)[axis] > 1e-4


@pytest.mark.parametrize("law", LAWS)
def test_actions_are_finite_and_within_limits_for_any_state(law):
    rng = np.random.default_rng(1)
    solo = load_solo(law).law
    with np.errstate(all="ignore"):
        solo.steer(np.zeros(N_STATE), np.zeros(3))
        for _ in range(200):
            x = rng.uniform(-3.0, 3.0, N_STATE) * np.array([1, 1, 1, 100, 1, 1, 1, 1, 1, 5000, 1, 1])
            action = solo.steer(x, rng.uniform(-1.0, 1.0, 3))
            assert np.abs(action).max() <= DEFLECTION_LIMIT
            solo.sent(action)


def test_an_integral_rests_at_the_limit_and_leaves_it_at_once():
    law = make_law("pid", SETTINGS_OF_LAWS)
    x = np.zeros(N_STATE)
    x[STATE.V], x[STATE.h] = 90.0, 2000.0
    for _ in range(2000):
        action = law.steer(x, np.array([0.0, 1.0, 0.0]))
    assert action[ACTION.da] == -DEFLECTION_LIMIT
    for _ in range(2):
        action = law.steer(x, np.array([0.0, -0.02, 0.0]))
    assert action[ACTION.da] > 0.0


def learn(sign_free, multipliers, samples=400):
    rng = np.random.default_rng(2)
    airframe = SETTINGS_OF_LAWS.airframe
    estimate = Effectiveness(airframe, SETTINGS_OF_LAWS.estimate, sign_free)
    motion_effect = rng.normal(size=(3, MOTIONS))
    effect = np.array(airframe.effectiveness) * multipliers
    for _ in range(samples):
        motion, command = 1e-3 * rng.normal(size=MOTIONS), 1e-3 * rng.normal(size=3)
        estimate.update(motion, command, 2.0, motion_effect @ motion + 2.0 * effect @ command)
    return estimate


def test_a_reversed_and_a_weak_surface_are_found():
    found = learn(True, np.array([-0.7, 0.4, 1.0])).multipliers
    np.testing.assert_allclose(found, [-0.7, 0.4, 1.0], atol=0.02)


def test_clamped_positive_a_reversed_surface_counts_as_weak():
    found = learn(False, np.array([-0.7, 0.4, 1.0])).multipliers
    np.testing.assert_allclose(found, [SETTINGS_OF_LAWS.estimate.least, 0.4, 1.0], atol=0.02)


def test_the_law_never_divides_by_nothing():
    for multiplier in (0.0, 1e-9, -1e-9, 1e9, -1e9):
        found = np.abs(learn(True, np.array([multiplier, 1.0, 1.0])).multipliers[0])
        assert SETTINGS_OF_LAWS.estimate.least <= found <= SETTINGS_OF_LAWS.estimate.most


def test_a_new_flight_begins_healthy():
    estimate = learn(True, np.array([-1.0, 1.0, 1.0]))
    estimate.reset()
    assert estimate.multipliers == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("law", LAWS)
def test_a_second_flight_is_flown_as_the_first(law, plant):
    solo, rng = load_solo(law).law, np.random.default_rng(3)
    states = plant.reset(NOMINAL) + 0.01 * rng.normal(size=(50, N_STATE))
    answers = []
    for _ in range(2):
        solo.reset()
        answers.append([])
        for x in states:
            action = solo.steer(x, np.array([0.05, 0.1, 0.0]))
            answers[-1].append(action.copy())
            solo.sent(action)
    np.testing.assert_array_equal(answers[0], answers[1])


def test_the_gains_say_what_is_wrong_with_them(tmp_path):
    bad = tmp_path / "gains.json"
    bad.write_text(SETTINGS.read_text().replace('"kappa"', '"kapa"'))
    with pytest.raises(UserError, match=r"gains\.json: .*kapa.*known keys: p0, kappa"):
        load_settings(bad)
    with pytest.raises(UserError, match=r"nowhere\.json: no such settings of the laws"):
        load_solo("pid", path=tmp_path / "nowhere.json")


def test_the_hash_is_the_settings(tmp_path):
    other = tmp_path / "gains.json"
    other.write_bytes(SETTINGS.read_bytes() + b"\n")
    assert load_solo("pid").sha256 == load_solo("indi").sha256 != load_solo("pid", path=other).sha256


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (
            [],
            "expected either --population FOLDER or --law "
            "pid|indi|indi-rls|indi-rls-signfree|indi-rls-protected, got none of them",
        ),
        (["--law", "pid", "--population", "x"], "got both"),
        (["--law", "pid", "--switch", "soft"], "--law pid: flies alone; expected --switch none"),
    ],
)
def test_who_flies_must_be_said_once(arguments, line):
    result = CliRunner().invoke(main, arguments)
    assert isinstance(result.exception, UserError)
    assert line in str(result.exception)


def test_late_commands_and_surfaces_far_behind_slow_the_loops_and_quiet_ones_let_them_go():
    pace = Pace((3.0, 4.0, 2.0), (20.0, 15.0, 10.0), DT)
    healthy = pace.attitude, pace.rate
    assert healthy == ((3.0, 4.0, 2.0), (20.0, 15.0, 10.0))
    pace.match(10, math.inf)
    assert pace.rate == (5.0, 5.0, 5.0)
    assert pace.attitude == (2.0, 2.0, 2.0)
    # Of how far the surfaces are away nothing depends while they are quick.
    pace.follow([0.1, 0.0, 0.0], [0.0, 0.0, 0.0])
    assert pace.rate == (5.0, 5.0, 5.0)
    rate = 0.05
    pace.match(0, rate)
    unseen = pace.rate
    assert unseen == pytest.approx([Pace.REACH * 2.0 * rate / Pace.WAY] * 3)
    pace.follow([0.0, 0.2, 0.0], [0.0, 0.0, 0.0])
    assert pace.rate == unseen
    for _ in range(round(20.0 / DT)):
        pace.follow([0.01, 0.01, 0.01], [0.01, 0.01, 0.01])
    assert (pace.attitude, pace.rate) == healthy
    pace.follow([0.0, 0.01, 0.0], [0.0, -0.01, 0.0])
    assert pace.rate == pytest.approx([Pace.REACH * 2.0 * rate / 0.02] * 3)
    pace.reset()
    assert (pace.attitude, pace.rate) == healthy
