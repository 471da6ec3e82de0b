import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.config import Operation
from runtime.guard import DOUBTFUL, MEANING, NAMES, UNUSABLE, Guard, Health, describe, plausible
from task.limits import DEFLECTION_LIMIT
from task.state import STATE

LEVEL = np.zeros(12)
LEVEL[STATE.V], LEVEL[STATE.h] = 90.0, 2000.0
any_float = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(any_float, any_float, any_float), min_size=1, max_size=8), st.integers(0, 3))
def test_whatever_a_policy_says_what_goes_out_is_finite_and_in_limits(actions, silences):
    guard = Guard(Operation())
    with np.errstate(all="ignore"):
        for action in actions:
            for out in (guard.command(np.array(action))[0], *(guard.fallback()[0] for _ in range(silences))):
                assert np.isfinite(out).all()
                assert np.abs(out).max() <= DEFLECTION_LIMIT


def test_flags_say_what_was_wrong():
    guard = Guard(Operation())
    assert guard.command(np.array([0.1, 0.0, 0.0]))[1] == Health.OK
    assert guard.command(np.array([0.2, 0.0, 0.0]))[1] == Health.ACTION_LIMITED
    assert guard.command(np.float32([DEFLECTION_LIMIT, 0.0, 0.0]))[1] == Health.OK
    out, health = guard.command(np.array([np.nan, 0.0, 0.0]))
    assert health == Health.ACTION_NOT_FINITE | Health.HOLDING
    assert out[0] == pytest.approx(DEFLECTION_LIMIT)
    assert "not finite" in describe(health)
    assert describe(Health.OK) == "well"


def test_without_a_state_the_last_command_is_held_then_fades_to_trim():
    guard = Guard(Operation(hold_time=0.1, fade_time=0.2, trim_time=1.0))
    for _ in range(2000):
        guard.command(np.array([-0.02, 0.0, 0.01]))
    guard.command(np.array([0.1, 0.05, 0.0]))
    outs = np.array([guard.fallback()[0].copy() for _ in range(60)])
    np.testing.assert_allclose(outs[:10], [[0.1, 0.05, 0.0]] * 10)
    assert -0.02 < outs[20][0] < 0.1
    np.testing.assert_allclose(outs[-1], [-0.02, 0.0, 0.01], atol=2e-3)
    guard.command(np.array([0.05, 0.0, 0.0]))
    np.testing.assert_allclose(guard.fallback()[0], [0.05, 0.0, 0.0])


@pytest.mark.parametrize(
    ("index", "value", "health"),
    [
        (STATE.q, np.nan, Health.STATE_NOT_FINITE),
        (STATE.xe, np.inf, Health.STATE_NOT_FINITE),
        (STATE.p, 50.0, Health.STATE_IMPLAUSIBLE),
        (STATE.V, 3000.0, Health.STATE_IMPLAUSIBLE),
        (STATE.theta, 60.0, Health.STATE_IMPLAUSIBLE),
        (STATE.h, 1e6, Health.STATE_IMPLAUSIBLE),
        (STATE.ye, 1e7, Health.OK),
        (STATE.psi, 40.0, Health.OK),
        (STATE.p, -5.0, Health.OK),
    ],
)
def test_a_state_is_believed_or_not(index, value, health):
    x = LEVEL.copy()
    x[index] = value
    assert Guard(Operation()).check_state(x) == health


def test_the_flags_are_the_bits_that_logs_hold():
    assert {name: flag for flag, name in NAMES.items()} == {
        "state_not_finite": 1, "state_implausible": 2, "state_missing": 4, "action_not_finite": 8, "action_limited": 16,
        "holding": 32, "gap": 64, "defect": 128, "state_jumps": 256, "coasting": 512,
    }  # fmt: skip
    assert set(MEANING) == set(NAMES)
    assert UNUSABLE == Health.STATE_NOT_FINITE | Health.STATE_IMPLAUSIBLE == 3
    assert DOUBTFUL == UNUSABLE | Health.STATE_JUMPS == 259


@pytest.mark.parametrize(
    ("signals", "most"),
    [
        ((STATE.p, STATE.q, STATE.r), 20.0),
        ((STATE.V,), 1000.0),
        ((STATE.alpha, STATE.beta, STATE.phi, STATE.theta), 2.0 * np.pi),
        ((STATE.h,), 50_000.0),
    ],
)
def test_a_state_is_believed_up_to_its_bound_either_way(signals, most):
    guard = Guard(Operation())
    for signal in signals:
        for sign in (1.0, -1.0):
            x = LEVEL.copy()
            x[signal] = sign * most
            assert guard.check_state(x) == Health.OK
            assert plausible(x)
            x[signal] = sign * most * (1.0 + 1e-12)
            assert guard.check_state(x) == Health.STATE_IMPLAUSIBLE
            assert not plausible(x[:10])
            assert guard.check_state(LEVEL) == Health.OK


def test_what_is_foretold_is_plausible_only_when_it_is_finite():
    x = LEVEL[:10].copy()
    assert plausible(x)
    for signal in (STATE.psi, STATE.beta):
        for wrong in (np.nan, np.inf, -np.inf):
            x[signal] = wrong
            assert not plausible(x)
        x[signal] = 0.0


def test_the_last_command_is_held_for_hold_time_and_has_faded_after_fade_time():
    guard = Guard(Operation(hold_time=0.1, fade_time=0.2, trim_time=1.0))
    guard.command(np.array([0.02, 0.0, 0.0]))
    guard.command(np.array([0.1, -0.04, 0.0]))
    trim = np.array([0.06, -0.02, 0.0])  # the mean of both
    held = np.array([0.1, -0.04, 0.0])
    outs, flags = zip(*((out.copy(), health) for out, health in (guard.fallback() for _ in range(40))), strict=True)
    assert set(flags) == {Health.HOLDING}
    for k, out in enumerate(outs, 1):
        fade = min(max((k - 10) / 20, 0.0), 1.0)
        np.testing.assert_allclose(out, held + fade * (trim - held), atol=1e-15)


def test_without_a_time_to_fade_trim_follows_the_sample_after_the_hold():
    guard = Guard(Operation(hold_time=0.0, fade_time=1e-9, trim_time=1.0))
    guard.command(np.array([0.0, 0.0, 0.0]))
    guard.command(np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(guard.fallback()[0], [0.05, 0.0, 0.0])


def test_trim_is_the_mean_of_all_good_commands_until_trim_time_and_forgets_from_then():
    guard, commands = Guard(Operation(hold_time=0.0, fade_time=0.01, trim_time=0.1)), np.linspace(-0.1, 0.1, 15)
    for each in commands[:10]:
        guard.command(np.array([each, 0.0, 0.0]))
    assert guard.fallback()[0][0] == pytest.approx(commands[:10].mean())
    mean = commands[:10].mean()
    for each in commands[10:]:
        guard.command(np.array([each, 0.0, 0.0]))
        mean += 0.1 * (each - mean)
    assert guard.fallback()[0][0] == pytest.approx(mean)


def test_a_bad_command_is_neither_held_nor_part_of_trim():
    guard = Guard(Operation(hold_time=0.0, fade_time=0.01))
    assert not guard.has_command
    assert guard.command(np.array([np.nan, 0.1, 0.1]))[0].tolist() == [0.0, 0.0, 0.0]
    assert not guard.has_command
    guard.command(np.array([0.05, 0.0, 0.0]))
    assert guard.has_command
    out, health = guard.command(np.array([0.1, np.inf, 0.0]))
    assert health == Health.ACTION_NOT_FINITE | Health.HOLDING
    assert out.tolist() == [0.05, 0.0, 0.0]
    guard.reset()
    assert not guard.has_command
    assert guard.fallback()[0].tolist() == [0.0, 0.0, 0.0]


def test_of_the_flight_before_no_command_is_held():
    guard = Guard(Operation(hold_time=0.5))
    guard.command(np.array([0.1, 0.05, -0.1]))
    guard.reset()
    assert guard.command(np.full(3, np.nan))[0].tolist() == [0.0, 0.0, 0.0]


def test_a_flight_that_starts_again_holds_and_trims_as_the_first():
    outs = []
    guard = Guard(Operation(hold_time=0.05, fade_time=0.05))
    for _ in range(2):
        for each in (0.1, -0.02, 0.06):
            guard.command(np.array([each, 0.0, -each]))
        outs.append([guard.fallback()[0].copy() for _ in range(12)])
        guard.reset()
    np.testing.assert_array_equal(outs[0], outs[1])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_command_beyond_its_limit_is_flagged_from_a_microradian_on_and_limited_in_any_case(sign):
    guard = Guard(Operation())
    for surface in range(3):
        for beyond, health in ((0.9e-6, Health.OK), (1.1e-6, Health.ACTION_LIMITED)):
            action = np.zeros(3)
            action[surface] = sign * (DEFLECTION_LIMIT + beyond)
            out, found = guard.command(action)
            assert found == health
            assert out[surface] == sign * DEFLECTION_LIMIT
    np.testing.assert_array_equal(guard.fallback()[0], [0.0, 0.0, sign * DEFLECTION_LIMIT])


def test_flags_in_words_begin_with_what_tells_most():
    assert describe(Health.HOLDING | Health.STATE_NOT_FINITE | Health.GAP) == (
        "the state is not finite; holding the last good command, then trim; samples are missing"
    )
