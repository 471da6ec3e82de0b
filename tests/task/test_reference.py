import numpy as np
import pytest

from task.limits import DT
from task.reference import FAMILIES, base_reference, cosine_steps, n_samples, random_reference
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


def test_families_are_those_that_training_evaluation_and_the_campaign_were_flown_with() -> None:
    in_degrees = {
        name: (kind.theta / DEGREE, kind.phi / DEGREE, kind.blocks, kind.smoothing, kind.levels)
        for name, kind in FAMILIES.items()
    }
    assert in_degrees == {
        "evaluation": (pytest.approx(12.0), pytest.approx(10.0), 5, 0.1, 6),
        "training": (pytest.approx(25.0), pytest.approx(45.0), 5, 1 / 6, None),
        "aggressive": (pytest.approx(15.0), pytest.approx(40.0), 10, 0.05, None),
    }


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_a_random_reference_holds_each_level_from_the_end_of_its_step_to_the_next(family: str) -> None:
    kind, duration = FAMILIES[family], 40.0
    rows = random_reference(np.random.default_rng(3), duration, 0.0, family)
    assert rows.shape == (4000, 3)
    block = 4000 // kind.blocks
    step = round(kind.smoothing * 4000)
    for i in range(kind.blocks):
        held = rows[i * block + step : (i + 1) * block]
        assert np.ptp(held, axis=0) == pytest.approx(0.0, abs=1e-12)
    levels = rows[block - 1 :: block, : REFERENCE.beta]
    assert levels.shape == (kind.blocks, 2)
    if kind.levels:
        assert levels[0] == pytest.approx([0.0, 0.0])
        amplitudes = np.array([kind.theta, kind.phi])
        among = (levels / amplitudes + 1.0) / 2.0 * (kind.levels - 1)
        assert among[1:] == pytest.approx(np.round(among[1:]))
    else:
        assert len(np.unique(levels)) == levels.size
        assert (np.sign(levels).min(), np.sign(levels).max()) == (-1.0, 1.0)


def test_the_base_case_ends_as_its_last_level_begins() -> None:
    reference = base_reference(80.0, theta_trim=0.0)
    assert reference.shape == (8000, 3)
    assert np.rad2deg(reference[-1]) == pytest.approx([-8.0, 2.0, 0.0], abs=1e-6)
    step = np.rad2deg(reference[[1600, 2000, 2399, 2400], REFERENCE.theta])  # 8 s wide, from 0 to 12 deg
    assert step == pytest.approx([0.0, 6.0, 12.0, 12.0], abs=1e-3)


def test_a_single_level_is_reached_and_held() -> None:
    signal = cosine_steps(np.array([0.5]), duration=4.0, smoothing=1.0)
    assert signal[[0, 50, 100, 399]] == pytest.approx([0.0, 0.25, 0.5, 0.5])


def test_samples_of_a_duration_are_rounded_not_cut() -> None:
    assert n_samples(0.29) == 29  # 0.29 / 0.01 is 28.999...
    assert n_samples(1.0, 0.02) == 50
