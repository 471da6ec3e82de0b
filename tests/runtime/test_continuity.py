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


def sideways(**jumps) -> list[int]:
    """Return which of ten states in level flight are refused, of which those from the sixth on jump by so much."""
    states = np.zeros((10, N_STATE))
    states[:, STATE.V], states[:, STATE.alpha], states[:, STATE.h] = 90.0, 0.05, 2000.0
    states[:, STATE.xe] = 0.9 * np.arange(10)
    for signal, size in jumps.items():
        states[5:, STATE[signal]] += size
    return refused(states)


FEW = list(range(5, 5 + Continuity.SOUND))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_kind_of_jump_counts_beyond_its_bound_and_not_below(sign):
    angle, rate, speed = Continuity.JUMP, Continuity.JERK, Continuity.SURGE
    assert (angle, rate, speed) == (0.015, 0.1, 2.0)
    assert sideways(phi=0.1, theta=sign * 1.01 * angle) == FEW
    assert sideways(phi=0.1, theta=sign * 0.99 * angle) == []
    for gyro in "pqr":
        assert sideways(phi=0.1, **{gyro: sign * 1.01 * rate}) == FEW
        assert sideways(phi=0.1, **{gyro: sign * 0.99 * rate}) == []
    assert sideways(phi=0.1, V=sign * 1.01 * speed) == FEW
    assert sideways(phi=0.1, V=sign * 0.99 * speed) == []


def test_two_jumps_are_garbage_with_attitude_among_them_and_three_in_any_case():
    for attitude in ("phi", "theta", "psi"):
        assert sideways(**{attitude: 0.1}) == []
        assert sideways(**{attitude: 0.1}, beta=0.1) == FEW
    assert sideways(alpha=0.1, V=9.0) == []
    assert sideways(beta=0.1, p=1.0) == []
    assert sideways(alpha=0.1, beta=0.1, q=1.0) == FEW
    assert sideways(alpha=0.1, V=9.0, r=1.0) == FEW
    assert sideways(beta=0.1, p=1.0, q=1.0, r=1.0) == []  # the gyros step together, and count once
    assert sideways(p=1.0, V=9.0) == []  # without an angle nothing is garbage


def test_after_garbage_three_states_must_follow_one_another_before_one_is_used():
    states = turning(30)
    states[10, STATE.theta : STATE.psi + 1] += 0.5  # one state: it jumps there, and back
    assert refused(states) == [10, 11, 12, 13]
    states[13, STATE.theta : STATE.psi + 1] += 0.5
    assert refused(states) == list(range(10, 18))  # four jumps by now


def test_states_across_a_gap_of_a_tenth_of_a_second_are_compared_by_the_time_between_them():
    states = turning(101, (0.5, 0.2, -0.2))[::10]
    assert refused(states, step=100_000) == []
    assert refused(states, step=10_000)[:1] == [1]  # a tenth of the time: the rates explain a tenth of the turn
    states[5:, [STATE.theta, STATE.phi]] += 0.2
    assert refused(states, step=100_000)[:1] == [5]
    assert refused(states, step=100_001) == []


def test_a_state_that_comes_again_is_compared_with_nothing():
    states = turning(4)
    states[2:, [STATE.theta, STATE.phi]] += 0.2
    continuity = Continuity()
    assert [continuity.broken(x, at) for x, at in zip(states.tolist(), (0, 10_000, 10_000, 20_000), strict=True)] == [
        False, False, False, False,
    ]  # fmt: skip


@pytest.mark.parametrize("bank", [0.6, 2.2, -1.2])
@pytest.mark.parametrize("pitch", [0.8, -0.8])
def test_rates_turn_attitude_and_flow_angles_as_kinematics_say(bank, pitch):
    """At 5 rad/s and a bank and pitch where every term counts, each sample turns each angle by up to three JUMPs."""
    states = np.zeros((3, N_STATE))
    states[:, : STATE.r + 1] = 3.0, 2.0, -4.0
    states[:, STATE.V], states[:, STATE.alpha], states[:, STATE.h] = 90.0, 0.3, 2000.0
    states[:, STATE.phi], states[:, STATE.theta] = bank, pitch
    for k in (1, 2):
        states[k, STATE.phi : STATE.h + 1] = states[k - 1, STATE.phi : STATE.h + 1] + DT * kinematic_rates(
            states[k - 1]
        )
        p, q, r, _, alpha, _ = states[k - 1, : STATE.beta + 1]
        states[k, STATE.alpha] += k * DT * q
        states[k, STATE.beta] = states[k - 1, STATE.beta] + DT * (p * np.sin(alpha) - r * np.cos(alpha))
    last, now = states[1:].tolist()
    assert not Continuity()._jumps(last, now, DT)
    for still in (STATE.phi, STATE.theta, STATE.psi, STATE.alpha, STATE.beta):  # one that does not move shows
        held, turned = list(now), abs(now[still] - last[still])
        held[still] = last[still]
        held[STATE.V] += 9.0
        expected = turned > 1.1 * Continuity.JUMP and still not in (STATE.alpha, STATE.beta)
        if turned > 1.1 * Continuity.JUMP or turned < 0.9 * Continuity.JUMP:
            assert Continuity()._jumps(last, held, DT) is expected


def test_steep_means_a_cosine_of_pitch_below_0_3_either_way_up():
    for pitch, steep in ((1.25, False), (1.28, True), (-1.28, True), (np.pi - 1.28, True), (np.pi - 1.25, False)):
        states = np.zeros((10, N_STATE))
        states[:, STATE.V], states[:, STATE.theta], states[:, STATE.xe] = 90.0, pitch, 0.9 * np.arange(10)
        states[5:, STATE.phi] += 0.4
        states[5:, STATE.psi] += 0.4
        assert (refused(states) == []) is steep


def test_jumps_are_measured_the_short_way_round_the_whole_turn():
    for size in (2.0 / np.pi, 1.0, 3.0):
        assert sideways(phi=size, theta=0.1) == FEW
    assert sideways(phi=2.0 * np.pi, psi=-2.0 * np.pi) == []
    assert sideways(phi=0.1, V=2.0) == []


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
