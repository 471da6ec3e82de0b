"""Sensors that stand still."""

import numpy as np
import pytest

from runtime.structured import Effectiveness
from runtime.stuck import Stuck, turning
from task.limits import DT
from task.model import kinematic_rates
from task.state import STATE
from tests.runtime.rate_aircraft import MODEL, SETTINGS, Aircraft, state, watch


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
@pytest.mark.parametrize("signal", [STATE.p, STATE.q, STATE.r])
def test_a_stuck_gyro_is_no_dead_surface_and_the_attitude_tells_the_rate_instead(noise, signal):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    pulling = aircraft.command
    aircraft.command = lambda: np.add(pulling(), (0.02, 0.0, 0.0))  # attitudes stay small
    watch(found, aircraft, 500)
    aircraft.stuck = {int(signal): None}
    watch(found, aircraft, 400)
    assert [i for i, stuck in enumerate(found.stuck.signals) if stuck] == [signal]
    np.testing.assert_allclose(found.believed, 1.0, atol=0.15)
    np.testing.assert_allclose(found.rates, aircraft.w, atol=0.02)
    x = aircraft.read()
    mended = found.mended(x)
    assert mended[signal] == found.rates[signal]
    assert (np.delete(mended, signal) == np.delete(x, signal)).all()
    aircraft.stuck = {}
    watch(found, aircraft, 100)
    assert not found.stuck.any
    assert found.mended(x) is x
    aircraft.effect = np.array([-1.0, -1.0, 1.0])
    watch(found, aircraft, 100)
    np.testing.assert_allclose(found.effectiveness[:2], -1.0, atol=0.2)


def test_symmetric_flight_is_no_stuck_sensor_and_an_angle_of_attack_that_stands_still_is():
    stuck = Stuck(DT)
    for k in range(20):  # roll, yaw and sideslip at rest, though the model has them move
        assert not stuck.look(state((0.0, 0.01 * k, 0.0), alpha=0.05 + 1e-3 * k).tolist(), [1e-3, 1e-3, 1e-3], 1e-4)
    told = [
        stuck.look(state((1e-3 * k, 0.1 + 1e-6 * k, 1e-3 * k), beta=k).tolist(), [0.0] * 3, 1e-4) for k in range(20)
    ]
    assert told.index(True) == 5  # 0.1 rad/s turn the body by 5 mrad in five samples
    assert stuck.signals == [False, False, False, True, False]


def looked(stuck, samples, read, step=(0.0, 0.0, 0.0), noise=1e-3):
    """Return the sample, from 1, at which another signal is first stuck, or None; read(k): p, q, r, alpha, beta."""
    for k in range(1, samples + 1):
        p, q, r, alpha, beta = read(k)
        if stuck.look([p, q, r, 90.0, alpha, beta, 0.0, 0.0, 0.0, 0.0], list(step), noise):
            return k
    return None


def moving(k):
    """Readings of sensors of which none repeats."""
    return 0.01 * k, 0.02 * k, 0.03 * k, 0.05 + 1e-3 * k, 1e-3 * k


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_rate_is_stuck_once_it_should_have_moved_by_five_standard_deviations_of_the_noise(axis):
    def still(k):
        return tuple(0.1 if i == axis else each for i, each in enumerate(moving(k)))

    for sign in (1.0, -1.0):
        step = [0.0, 0.0, 0.0]
        step[axis] = sign * 1.001e-3
        assert looked(Stuck(DT), 50, still, step) == 6  # the first reading repeats nothing
        step[axis] = sign * 0.999e-3
        assert looked(Stuck(DT), 50, still, step) == 7
        step[axis] = sign * 1.0
        assert looked(Stuck(DT), 50, still, step) == 1 + Stuck.SAME == 4
        step[axis] = sign * 1e-5
        assert looked(Stuck(DT), 400, still, step) is None


@pytest.mark.parametrize(
    ("rates", "signal"),
    [((0.0, 0.101, 0.0), 3), ((0.0, 0.0, 0.101), 4), ((0.0, -0.101, 0.0), 3), ((1.0, 0.0, -0.051), 4)],
)
def test_an_angle_is_stuck_once_the_rates_have_turned_the_body_by_5_mrad(rates, signal):
    def still(k):
        p, q, r = (each + 1e-7 * k for each in rates)
        alpha, beta = (0.05 + 1e-9 * k, 0.0) if signal == 4 else (0.05, 1e-9 * k)
        return p, q, r, alpha, beta

    stuck = Stuck(DT)
    assert looked(stuck, 50, still) == 6  # 1 mrad a sample
    assert [i for i, each in enumerate(stuck.signals) if each] == [signal]
    assert stuck.mask == 1 << signal
    assert stuck.blind == ((False, True, False) if signal == 3 else (True, False, True))


def test_a_reading_that_changes_by_a_bit_is_well_again_and_begins_to_count_anew():
    stuck = Stuck(DT)
    still = lambda k: (0.1, *moving(k)[1:])  # noqa: E731
    assert looked(stuck, 50, still, (1.0, 0.0, 0.0)) == 4
    assert stuck.any
    assert stuck.blind == (True, False, False)
    assert looked(stuck, 1, lambda k: (0.1 + 1e-15, *moving(99)[1:]), (1.0, 0.0, 0.0)) is None
    assert (stuck.any, stuck.mask, stuck.signals) == (False, 0, [False] * 5)
    assert stuck.blind == (False, False, False)
    assert looked(stuck, 50, still, (1.0, 0.0, 0.0)) == 4


def test_of_two_that_stand_still_the_one_that_moves_again_is_well():
    stuck = Stuck(DT)
    both = lambda k: (0.1, *moving(k)[1:2], 0.2, *moving(k)[3:])  # noqa: E731
    assert looked(stuck, 50, both, (1.0, 0.0, 1.0)) == 4
    assert stuck.signals == [True, False, True, False, False]
    assert stuck.mask == 5
    assert not looked(stuck, 1, lambda k: (0.3, *moving(88)[1:2], 0.2, *moving(88)[3:]))
    assert stuck.signals == [False, False, True, False, False]
    assert stuck.any


def test_what_is_stuck_is_said_once_and_another_one_again():
    stuck, told = Stuck(DT), []
    for k in range(1, 20):
        _, q, r, alpha, beta = moving(k)
        r = 0.2 if k >= 8 else r
        told.append(stuck.look([0.1, q, r, 90.0, alpha, beta, 0, 0, 0, 0], [1.0, 0.0, 1.0], 1e-3))
    assert [k for k, each in enumerate(told, 1) if each] == [4, 11]


@pytest.mark.parametrize("still", [(0, 2, 4), (1, 3)])
def test_while_all_signals_of_a_motion_stand_still_nothing_is_due(still):
    held = moving(5)

    def read(k):
        return tuple(held[i] if i in still else each for i, each in enumerate(moving(k)))

    stuck = Stuck(DT)
    assert looked(stuck, 50, read, (1.0, 1.0, 1.0)) is None
    # and once one of them moves, the others are due from there on
    ended = looked(stuck, 50, lambda k: tuple(
        each if i == still[0] else before for i, (each, before) in enumerate(zip(moving(k + 60), read(k), strict=True))
    ), (0.0, 0.0, 1.01e-3))  # fmt: skip
    assert ended is not None


def test_the_attitude_tells_the_rates_at_any_bank_and_pitch_and_across_the_turn():
    rates = np.array([0.3, -0.2, 0.15])
    for phi, theta, psi in ((0.5, 0.3, 1.0), (-1.2, -0.6, 0.0), (2.5, 0.2, np.pi - 1e-4), (np.pi - 1e-4, 0.1, 0.0)):
        x = state(rates)
        x[[STATE.phi, STATE.theta, STATE.psi]] = phi, theta, psi
        before = x.copy()
        dots = kinematic_rates(x)[:3]
        before[[STATE.phi, STATE.theta, STATE.psi]] -= 1e-4 * dots
        x[[STATE.phi, STATE.psi]] = (x[[STATE.phi, STATE.psi]] + np.pi) % (2.0 * np.pi) - np.pi
        before[[STATE.phi, STATE.psi]] = (before[[STATE.phi, STATE.psi]] + np.pi) % (2.0 * np.pi) - np.pi
        np.testing.assert_allclose(turning(before.tolist(), x.tolist(), rates.tolist(), 1e-4), rates, atol=1e-9)


def test_at_a_bank_of_a_quarter_turn_the_attitude_says_no_wild_rates():
    x = state((0.0, 0.0, 0.0))
    for phi, sign in ((np.pi / 2 - 1e-6, 1.0), (np.pi / 2 + 1e-6, -1.0)):
        x[STATE.phi] = phi
        before = x.copy()
        before[STATE.theta] -= 1e-3
        assert turning(before.tolist(), x.tolist(), [0.0] * 3, 0.01)[1] == pytest.approx(sign * 0.1 / 0.1)
