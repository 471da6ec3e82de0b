import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.config import Operation
from runtime.guard import Guard, Health, describe
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
