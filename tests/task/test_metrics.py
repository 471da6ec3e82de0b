import numpy as np
import pytest

from task.metrics import C_SM, channel_nmae, nmae, smoothness

DEGREE = np.pi / 180


def test_nmae_by_hand() -> None:
    error = np.tile(np.array([2.0, -4.0, 0.25]) * DEGREE, (50, 1))
    assert channel_nmae(error) == pytest.approx([0.1, 0.2, 0.25])
    assert nmae(error) == pytest.approx(100 * (0.1 + 0.2 + 0.25) / 3)
    assert channel_nmae(error, "text") == pytest.approx([0.08, 0.16, 0.25])


def test_constant_sideslip_has_a_floor_of_one_third() -> None:
    error = np.zeros((50, 3))
    error[:, 2] = 7 * DEGREE
    assert nmae(error) == pytest.approx(100 / 3)


def test_smoothness_of_a_sine_is_its_closed_form() -> None:
    # One sine of amplitude A at bin f: S = (A n/2)^2 dt, so Sm = -C/T sqrt(2/n * (A n/2)^2 dt * f).
    n, dt, f, amplitude = 2000, 0.01, 2.0, 0.1
    t = np.arange(n) * dt
    actions = np.zeros((n, 3))
    actions[:, 0] = amplitude * np.sin(2 * np.pi * f * t)
    expected = -C_SM / (n * dt) * np.sqrt(2 / n * (amplitude * n / 2) ** 2 * dt * f)
    assert smoothness(actions, dt) == pytest.approx(expected)


def test_smoother_is_higher_and_trim_is_free() -> None:
    t = np.arange(2000) * 0.01
    slow, fast = (np.sin(2 * np.pi * f * t)[:, None] for f in (0.5, 20.0))
    assert smoothness(slow) > smoothness(fast)
    assert smoothness(slow + 0.1) == pytest.approx(smoothness(slow))
    assert smoothness(np.ones((100, 3))) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("n", [2, 3, 4, 9, 16])
def test_smoothness_is_eq_16_up_to_half_the_sampling_rate(n: int) -> None:
    actions, dt = np.random.default_rng(n).normal(size=(n, 2)), 0.02
    total = 0.0
    for k in range(1, n // 2 + 1):
        spectrum = np.abs((actions * np.exp(-2j * np.pi * k * np.arange(n) / n)[:, None]).sum(axis=0)) ** 2 * dt
        total += spectrum.sum() * k / (n * dt)
    assert smoothness(actions, dt) == pytest.approx(-8000.0 / (n * dt) * np.sqrt(2.0 / n * total))


def test_smoothness_of_less_than_two_samples_is_zero() -> None:
    assert smoothness(np.ones((1, 3))) == 0.0
    assert smoothness(np.ones((0, 3))) == 0.0


def test_sideslip_is_divided_by_its_mean_beyond_one_degree_to_either_side_and_attitude_by_20() -> None:
    error = np.zeros((4, 3))
    error[:, 2] = np.array([-1.0, -3.0, -2.0, 2.0]) * DEGREE  # mean -1, mean size 2
    assert channel_nmae(error) == pytest.approx([0.0, 0.0, 2.0])
    error[:, 2] -= 3.0 * DEGREE  # mean -4, mean size 4
    assert channel_nmae(error) == pytest.approx([0.0, 0.0, 1.0])
    error[:, :2] = 20.0 * DEGREE
    assert channel_nmae(error)[:2] == pytest.approx([1.0, 1.0])
