"""What can follow a state, and what cannot: garbage is refused, gusts and sensors that step are not."""

import numpy as np
import pytest

from runtime.continuity import Continuity
from task.limits import DT
from task.model import kinematic_rates
from task.state import N_STATE, STATE

USEC = round(1e6 * DT)


def turning(samples: int, rates=(1.0, 0.3, -0.3)) -> np.ndarray:
    """Return states (samples, 12) of a body that turns at constant rates [rad/s]."""
    x = np.zeros((samples, N_STATE))
    x[:, : STATE.r + 1] = rates
    x[:, STATE.V], x[:, STATE.alpha], x[:, STATE.h] = 90.0, 0.05, 2000.0
    for k in range(1, samples):
        x[k, STATE.phi : STATE.h + 1] = x[k - 1, STATE.phi : STATE.h + 1] + DT * kinematic_rates(x[k - 1])
    return x


def refused(states: np.ndarray, step: int = USEC) -> list[int]:
    """Return which states are refused."""
    continuity = Continuity()
    return [k for k, x in enumerate(states.tolist()) if continuity.broken(x, k * step)]


@pytest.mark.parametrize("rates", [(0.0, 0.0, 0.0), (4.0, 0.5, -0.5), (-4.0, -0.8, 0.4)])
def test_fast_turns_through_every_angle_are_flight(rates):
    states = turning(150, rates)
    states[:, STATE.phi : STATE.psi + 1] = np.remainder(states[:, STATE.phi : STATE.psi + 1] + np.pi, 2 * np.pi) - np.pi
    assert refused(states) == []


@pytest.mark.parametrize(
    "jumps",
    [{STATE.theta: 0.1}, {STATE.psi: 3.0}, {STATE.alpha: 0.08, STATE.beta: 0.05}, {STATE.p: 2.0}, {STATE.V: 20.0}],
)
def test_one_sensor_that_steps_and_a_gust_are_no_garbage(jumps):
    states = turning(100)
    for signal, size in jumps.items():
        states[50:, signal] += size
    assert refused(states) == []


@pytest.mark.parametrize(
    "jumps",
    [{STATE.theta: 0.02, STATE.phi: -0.02}, {STATE.psi: 0.05, STATE.alpha: 0.05}, {STATE.phi: 0.1, STATE.V: 5.0},
     {STATE.alpha: 0.05, STATE.beta: 0.05, STATE.V: 5.0}],
)  # fmt: skip
def test_what_jumps_and_stays_costs_a_few_samples(jumps):
    states = turning(100)
    for signal, size in jumps.items():
        states[50:, signal] += size
    assert refused(states) == list(range(50, 50 + Continuity.SOUND))


def test_of_garbage_hardly_anything_passes():
    states = turning(5000, (0.01, 0.02, 0.0))
    spread = np.zeros(N_STATE)
    spread[: STATE.r + 1], spread[STATE.V], spread[STATE.alpha : STATE.psi + 1] = 0.2, 10.0, 0.06
    states[100:] += np.random.default_rng(0).uniform(-spread, spread, (4900, N_STATE))
    assert len(refused(states)) > 0.998 * 4900


def test_gyros_and_attitude_that_are_only_noisy_pass():
    states, rng = turning(5000, (0.01, 0.02, 0.0)), np.random.default_rng(1)
    states[:, : STATE.r + 1] += 0.05 * rng.standard_normal((5000, 3))
    states[:, STATE.alpha : STATE.psi + 1] += 2e-3 * rng.standard_normal((5000, 5))
    assert refused(states) == []


def test_across_a_long_gap_nothing_is_compared():
    states = turning(3)
    states[2, STATE.theta], states[2, STATE.phi] = 0.5, 0.5
    assert refused(states, step=round(1e6 * Continuity.LONGEST) + 1) == []
    assert refused(states) == [2]


def test_at_steep_pitch_bank_and_heading_are_not_told_apart():
    states = turning(10, (0.0, 0.0, 0.0))
    states[:, STATE.theta] = 1.5
    states[5:, STATE.phi], states[5:, STATE.psi] = 0.4, 0.4
    assert refused(states) == []


def test_a_state_that_stands_still_to_the_last_bit_is_refused_from_its_second_repetition_on():
    states = turning(100, (0.01, 0.02, 0.0))
    states[:, STATE.xe] = 0.9 * np.arange(100)
    states[50:60] = states[49]
    assert refused(states)[:8] == list(range(51, 59))
    assert refused(np.repeat(states[:40], 2, axis=0)) == []  # a source of half the rate
    still = turning(100, (0.0, 0.0, 0.0))
    still[:, STATE.xe] = 0.9 * np.arange(100)  # in trim, all but the position may repeat
    assert refused(still) == []


def noisy(samples: int, sd: float, first: int = 0) -> np.ndarray:
    """Return states whose angles have noise of sd [rad] from a sample on, and whose speed has as much for its size."""
    states, rng = turning(samples, (0.01, 0.02, 0.0)), np.random.default_rng(2)
    states[first:, STATE.alpha : STATE.psi + 1] += sd * rng.standard_normal((samples - first, 5))
    states[first:, STATE.V] += 167.0 * sd * rng.standard_normal(samples - first)
    return states


def test_sensors_that_are_noisy_all_the_time_say_no_garbage():
    assert len(refused(noisy(3000, 0.012))) < 0.02 * 3000
    refusals = refused(noisy(3000, 0.012, 1000))
    assert len(refusals) < 150
    assert len([k for k in refusals if k > 1300]) < 0.02 * 3000


def test_garbage_that_lasts_stays_garbage_and_ends_with_it():
    states = turning(3000, (0.01, 0.02, 0.0))
    spread = np.zeros(N_STATE)
    spread[: STATE.r + 1], spread[STATE.V], spread[STATE.alpha : STATE.psi + 1] = 0.2, 10.0, 0.06
    states[1000:2000] += np.random.default_rng(0).uniform(-spread, spread, (1000, N_STATE))
    refusals = refused(states)
    assert len([k for k in refusals if 1000 <= k < 2000]) > 990
    assert max(refusals) <= 2000 + Continuity.SOUNDEST
