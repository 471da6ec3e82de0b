import numpy as np
import pytest

from task.limits import DT
from task.reference import FAMILIES, base_reference, cosine_steps, random_reference
from task.state import REFERENCE

DEGREE = np.pi / 180


def test_cosine_steps_reach_each_level_and_hold_it() -> None:
    signal = cosine_steps(np.array([1.0, -2.0, 0.5]), duration=20.0, smoothing=2.0)
    assert signal.shape == (2000,)
    assert signal[0] == 0.0
    assert signal[100] == pytest.approx(0.5, abs=1e-12)  # half of the first step, half of its width
    assert signal[999] == pytest.approx(1.0)
    assert signal[1100] == pytest.approx(-0.5)
    assert signal[1300] == pytest.approx(-2.0)


def test_cosine_steps_are_smooth() -> None:
    amplitude, smoothing = 3.0, 2.0
    signal = cosine_steps(np.array([amplitude, 0.0]), duration=10.0, smoothing=smoothing)
    steepest = amplitude / 2 * np.pi / smoothing
    assert np.abs(np.diff(signal)).max() / DT == pytest.approx(steepest, rel=1e-3)


def test_base_case_is_the_printed_one() -> None:
    reference = base_reference(80.0, theta_trim=0.1)
    held = reference[np.array([10.0, 26.0, 42.0, 58.0, 74.0]).astype(int) * 100]
    theta = np.rad2deg(held[:, REFERENCE.theta] - 0.1)
    assert theta == pytest.approx([0.0, 12.0, 3.0, -4.0, -8.0])
    assert np.rad2deg(held[:, REFERENCE.phi]) == pytest.approx([2.0, -2.0, 2.0, 10.0, 2.0])
    assert not reference[:, REFERENCE.beta].any()


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_random_references_stay_in_their_family_and_follow_the_seed(family: str) -> None:
    kind = FAMILIES[family]
    first = random_reference(np.random.default_rng(5), 20.0, 0.02, family)
    assert np.array_equal(first, random_reference(np.random.default_rng(5), 20.0, 0.02, family))
    assert not np.array_equal(first, random_reference(np.random.default_rng(6), 20.0, 0.02, family))
    assert np.abs(first[:, REFERENCE.theta] - 0.02).max() <= kind.theta + 1e-12
    assert np.abs(first[:, REFERENCE.phi]).max() <= kind.phi + 1e-12
    assert first[0] == pytest.approx([0.02, 0.0, 0.0])


def test_evaluation_levels_come_from_six_values() -> None:
    rng = np.random.default_rng(0)
    held = {round(float(np.rad2deg(random_reference(rng, 80.0, 0.0)[2600, REFERENCE.theta])), 6) for _ in range(100)}
    assert held == {-12.0, -7.2, -2.4, 2.4, 7.2, 12.0}
