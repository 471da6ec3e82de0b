"""The level of sensor noise and of turbulence, by hand and on white noise."""

import math

import numpy as np
import pytest

from runtime.unrest import Unrest

LEAST = 1e-4


def heard(unrest, rates, turning=None):
    """Let a level hear rates (N, 3) and what the attitude says of them."""
    for w, turned in zip(rates.tolist(), (rates if turning is None else turning).tolist(), strict=True):
        unrest.hear(tuple(w), tuple(turned))


def fresh(noise_gain=0.005, unrest_gain=0.01):
    unrest = Unrest(LEAST, noise_gain, unrest_gain)
    unrest.restart((0.0, 0.0, 0.0))
    return unrest


def white(samples, sd, seed=0):
    return sd * np.random.default_rng(seed).standard_normal((samples, 3))


def test_the_variance_of_white_noise_is_found_and_never_below_the_least():
    unrest = fresh()
    heard(unrest, white(4000, 1e-3))
    assert unrest.noise_variance**0.5 == pytest.approx(1e-3, rel=0.1)
    assert unrest.variances == [unrest.noise_variance] * 3
    unrest = fresh()
    heard(unrest, white(500, 1e-6))
    assert unrest.noise_variance == LEAST**2


def test_a_smooth_motion_is_no_noise():
    t = 0.01 * np.arange(3000)
    unrest = fresh()
    heard(unrest, np.column_stack([np.sin(3.0 * t), 1.0 - np.cos(2.0 * t), 0.1 * t**2]))
    assert unrest.noise_variance == LEAST**2


def test_the_first_samples_count_alike_and_later_ones_by_their_gain():
    unrest = fresh(noise_gain=0.01)
    rates = np.zeros((3, 3))
    rates[0] = 0.1, 0.2, -0.2
    for k, weight in enumerate((1.0, 9.0, 9.0)):  # the third difference of one step is 1, -3, 3 ... of it
        before = unrest.noise_variance
        heard(unrest, rates[k : k + 1])
        seen = weight * 0.09 / 60.0
        assert unrest.noise_variance == pytest.approx(before + (seen - before) / (k + 1))
    unrest.seen, unrest.noise_variance = 500, 1e-4
    unrest.restart((0.0, 0.0, 0.0))
    heard(unrest, np.zeros((1, 3)))
    assert unrest.noise_variance == pytest.approx(0.99e-4)


def test_a_loud_sample_counts_as_four_times_the_noise_once_that_is_known():
    unrest = fresh(noise_gain=0.01)
    heard(unrest, white(200, 1e-3))
    before = unrest.noise_variance
    unrest.restart((0.0, 0.0, 0.0))
    heard(unrest, np.full((1, 3), 1.0))
    assert unrest.noise_variance == pytest.approx(before * (1.0 + 0.01 * 3.0))
    assert not unrest.broke


def test_noise_is_known_after_a_hundred_samples_and_turbulence_after_two_hundred_more():
    unrest, ends, known = fresh(), [], []
    for k in range(1, 400):
        heard(unrest, np.zeros((1, 3)))
        if unrest.ends_a_phase:
            ends.append(k)
        if unrest.known:
            known.append(k)
    assert ends == [100, 300]
    assert known[0] == 301
    unrest.reset()
    assert (unrest.seen, unrest.known, unrest.levels, unrest.noise_variance) == (0, False, [1.0] * 3, LEAST**2)


def felt(unrest, *surprises):
    for each in surprises:
        unrest.feel(each)
    return unrest.levels


def test_turbulence_is_felt_from_when_noise_is_known_and_settles_where_surprises_are_one():
    unrest = fresh()
    unrest.seen = Unrest.LEARNING
    assert felt(unrest, (5.0, 5.0, 5.0)) == [1.0] * 3
    unrest.seen = 1000
    assert felt(unrest, (5.0, 1.0, 0.0)) == pytest.approx([math.exp(0.04), 1.0, 1.0])
    unrest.levels = [2.0, 3.0, 4.0]
    assert felt(unrest, (1.0, 0.5, 2.0)) == pytest.approx([2.0, 3.0 * math.exp(-0.005), 4.0 * math.exp(0.01)])


def test_soon_after_noise_is_known_a_sample_says_more_of_turbulence():
    unrest = fresh()
    unrest.seen = Unrest.LEARNING + 15
    assert felt(unrest, (2.0, 1.0, 1.0)) == pytest.approx([math.exp(1.0 / 20.0), 1.0, 1.0])


@pytest.mark.parametrize("wild", [20.0, math.inf, math.nan])
def test_one_sample_is_no_turbulence(wild):
    unrest = fresh()
    unrest.seen = 1000
    assert felt(unrest, (wild, 1.0, 1.0)) == pytest.approx([math.exp(0.01 * 8.0), 1.0, 1.0])


def test_every_axis_has_a_share_of_the_roughest_one_s_level_and_none_is_without_bound():
    unrest = fresh()
    unrest.seen = 1000
    unrest.levels = [1000.0, 1.0, 1.0]
    assert felt(unrest, (1.0, 1.0, 1.0)) == pytest.approx([1000.0, 3.0, 3.0])
    unrest.levels = [1.0, Unrest.WILDEST, 1.0]
    assert felt(unrest, (1.0, 9.0, 1.0))[1] == Unrest.WILDEST


def broken(axes=(0, 1, 2), sd=0.05, moved=0.0, samples=9):
    """Return a level after quiet flight and some samples with noise of which the attitude confirms a share."""
    unrest = fresh()
    heard(unrest, white(400, 1e-3))
    rates = white(samples, 1e-3, 1)
    loud = white(samples, sd, 2)
    rates[:, list(axes)] += loud[:, list(axes)]
    said = []
    for w in rates:
        heard(unrest, w[None], moved * w[None])
        said.append(unrest.broke)
    return unrest, said


def test_gyros_that_become_noisy_are_found_once_most_of_nine_samples_are_loud():
    unrest, said = broken()
    assert said.index(True) in (4, 5)
    assert not any(said[:4])
    ratio = np.sqrt(unrest.variances) / 0.05
    assert (ratio > 0.5).all()
    assert (ratio < 3.0).all()
    assert unrest.noise_variance**0.5 == pytest.approx(1e-3, rel=0.3)  # what was learnt stays


def test_only_the_axes_that_are_noisy_get_more():
    unrest, said = broken(axes=(1,))
    assert any(said)
    p, q, r = np.sqrt(unrest.variances)
    assert (p, r) == pytest.approx((1e-3, 1e-3), rel=0.3)
    assert 0.02 < q < 0.15


@pytest.mark.parametrize(("moved", "found"), [(0.0, True), (0.4, True), (0.6, False), (1.0, False)])
def test_what_the_attitude_confirms_is_motion(moved, found):
    assert any(broken(moved=moved)[1]) is found


def test_noise_three_times_as_large_is_not_taken_for_broken_gyros():
    assert not any(broken(sd=0.002, samples=100)[1])


def test_the_extra_noise_fades_with_what_is_measured_and_is_gone_in_a_new_flight():
    unrest, _ = broken()
    worst = max(unrest.variances)
    heard(unrest, white(400, 1e-3, 3))
    assert max(unrest.variances) < 0.01 * worst
    assert max(unrest.variances) >= unrest.noise_variance
    unrest, _ = broken()
    unrest.reset()
    assert unrest.variances == [LEAST**2] * 3
    assert not unrest.broke


def test_after_a_gap_the_last_rates_are_no_neighbours():
    unrest = fresh()
    heard(unrest, np.zeros((200, 3)))
    unrest.restart((0.5, -0.5, 0.2))
    heard(unrest, np.tile([0.5, -0.5, 0.2], (20, 1)))
    assert unrest.noise_variance == LEAST**2
