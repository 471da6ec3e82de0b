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
