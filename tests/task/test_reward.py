import numpy as np
import pytest

from task.observation import observation, tracking_error
from task.reward import crash_penalty, terminated, tracking_reward, unsafe
from task.state import N_STATE, OBSERVATION, STATE

DEGREE = np.pi / 180


def level(**values: float) -> np.ndarray:
    x = np.zeros(N_STATE)
    x[STATE.V], x[STATE.h] = 90.0, 2000.0
    for name, value in values.items():
        x[STATE[name]] = value
    return x


def test_reward_by_hand() -> None:
    # 6/pi * 15 deg = 0.5 on theta and phi; 4 * 6/pi * 15 deg saturates at 1 on beta.
    error = np.array([15.0, -15.0, 15.0]) * DEGREE
    assert tracking_reward(error) == pytest.approx(-(0.5 + 0.5 + 1.0) / 3)


def test_reward_is_symmetric_and_bounded() -> None:
    error = np.random.default_rng(0).normal(size=(100, 3))
    assert np.array_equal(tracking_reward(error), tracking_reward(-error))
    assert tracking_reward(error * 1e6).min() == pytest.approx(-1.0)
    assert tracking_reward(np.zeros(3)) == 0.0


def test_crash_penalty_counts_lost_frames() -> None:
    assert crash_penalty(1.5) == pytest.approx(-2.0 * 150)


@pytest.mark.parametrize(
    ("values", "lost"),
    [
        ({}, False),
        ({"theta": 59.9 * DEGREE, "phi": -74.9 * DEGREE}, False),
        ({"theta": -60.1 * DEGREE}, True),
        ({"phi": 75.1 * DEGREE}, True),
        ({"h": 49.0}, True),
        ({"q": np.nan}, True),
        ({"V": np.inf}, True),
    ],
)
def test_termination(values: dict[str, float], lost: bool) -> None:
    assert bool(terminated(level(**values))) is lost


def test_unsafe_is_stated_in_radians() -> None:
    states = np.stack([level(alpha=10.9 * DEGREE), level(alpha=11.1 * DEGREE), level(phi=-61 * DEGREE), level(phi=1.0)])
    assert unsafe(states).tolist() == [False, True, True, False]


def test_observation_is_eq_11() -> None:
    x = np.arange(float(N_STATE))
    reference = np.array([10.0, 20.0, 30.0])
    s = observation(x, reference)
    assert s.tolist() == [10.0 - 7, 20.0 - 6, 30.0 - 5, 0.0, 1.0, 2.0, 4.0]
    assert np.array_equal(s[: OBSERVATION.p], tracking_error(x, reference))
    out = np.empty((4, 7), dtype=np.float32)
    assert observation(np.tile(x, (4, 1)), reference, out=out) is out
    assert np.array_equal(out[3], s.astype(np.float32))


@pytest.mark.parametrize(("name", "limit"), [("theta", 60.0 * DEGREE), ("phi", 75.0 * DEGREE)])
def test_an_attitude_is_lost_beyond_its_limit_and_not_at_it(name: str, limit: float) -> None:
    for sign in (1.0, -1.0):
        assert not terminated(level(**{name: sign * limit}))
        assert terminated(level(**{name: sign * limit * (1.0 + 1e-12)}))


def test_below_50_m_the_aircraft_is_lost_and_at_50_m_not() -> None:
    assert not terminated(level(h=50.0))
    assert terminated(level(h=49.999))


def test_a_flight_is_unsafe_at_11_deg_of_angle_of_attack_and_at_60_deg_of_bank() -> None:
    at = [level(alpha=11.0 * DEGREE), level(phi=60.0 * DEGREE), level(phi=-60.0 * DEGREE)]
    below = [level(alpha=10.999 * DEGREE), level(phi=59.999 * DEGREE), level(phi=-59.999 * DEGREE)]
    assert unsafe(np.stack(at)).all()
    assert not unsafe(np.stack(below)).any()
    assert not unsafe(level(alpha=-20.0 * DEGREE))


def test_each_of_many_states_is_lost_or_not_by_itself() -> None:
    states = np.stack([level(), level(phi=80.0 * DEGREE), level(psi=np.nan), level()])
    assert terminated(states).tolist() == [False, True, True, False]


def test_each_error_costs_at_most_a_third_and_saturates_at_30_and_sideslip_at_7_5_deg() -> None:
    for channel, full in enumerate((30.0, 30.0, 7.5)):
        for sign in (1.0, -1.0):
            error = np.zeros(3)
            error[channel] = sign * 0.5 * full * DEGREE
            assert tracking_reward(error) == pytest.approx(-0.5 / 3)
            error[channel] = sign * 2.0 * full * DEGREE
            assert tracking_reward(error) == pytest.approx(-1.0 / 3)


def test_a_lost_frame_costs_as_much_at_any_sample_time() -> None:
    assert crash_penalty(1.5, 0.02) == pytest.approx(-2.0 * 75)
    assert crash_penalty(np.array([0.0, 1.0]), 0.1) == pytest.approx([0.0, -20.0])


def test_many_observations_at_once_are_each_of_them() -> None:
    rng = np.random.default_rng(0)
    x, reference = rng.normal(size=(2, 5, N_STATE)), rng.normal(size=(2, 5, 3))
    seen = observation(x, reference)
    assert seen.shape == (2, 5, 7)
    for place in np.ndindex(2, 5):
        assert np.array_equal(seen[place], observation(x[place], reference[place]))
    assert observation(x.astype(np.float32), reference.astype(np.float32)).dtype == np.float32
