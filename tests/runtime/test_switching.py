import numpy as np
import pytest

from runtime.config import Adaptation
from runtime.presets import PRESETS
from runtime.switching import REASONS, Action, Cast, Decision, Reason, decide

SOFT = Adaptation(switch="soft", margin=0.5, prior="none")
HARD = Adaptation(switch="hard", margin=0.5, prior="none")
NONE = Adaptation(switch="none", prior="none")
NAN = float("nan")


@pytest.mark.parametrize(
    ("returns", "flying", "age", "settings", "action", "member", "reason"),
    [
        ([-40.0, -60.0, -100.0], 1, 0.1, SOFT, Action.SOFT, 0, Reason.BETTER),
        ([-40.0, -60.0, -100.0], 1, 0.1, HARD, Action.HARD, 0, Reason.BETTER),
        ([-40.0, -60.0, -100.0], 1, 0.1, NONE, Action.KEEP, 0, Reason.SWITCHED_OFF),
        ([-50.0, -60.0, -100.0], 1, 0.1, SOFT, Action.KEEP, 0, Reason.MARGIN),  # the margin itself is not beyond it
        ([-49.9, -60.0, -100.0], 1, 0.1, SOFT, Action.SOFT, 0, Reason.BETTER),
        ([-90.0, -60.0, -100.0], 1, 0.1, SOFT, Action.KEEP, 1, Reason.INCUMBENT_IS_BEST),
        ([-40.0, -60.0, -100.0], 1, 1.1, SOFT, Action.KEEP, 0, Reason.TOO_OLD),
        ([NAN, -60.0, -200.0], 0, 0.1, SOFT, Action.SOFT, 1, Reason.BETTER),
        ([NAN, -np.inf, -200.0], 0, 0.1, SOFT, Action.KEEP, -1, Reason.NO_PREDICTION),
        ([-40.0, -60.0, NAN], 1, 0.1, SOFT, Action.SOFT, 0, Reason.INCUMBENT_UNKNOWN),
        ([-40.0, -60.0, NAN], 0, 0.1, SOFT, Action.KEEP, 0, Reason.INCUMBENT_IS_BEST),
        ([0.0, -1.0, 0.0], 1, 0.1, SOFT, Action.KEEP, 0, Reason.MARGIN),
        ([30.0, 10.0, 15.0], 1, 0.1, SOFT, Action.SOFT, 0, Reason.BETTER),  # positive returns: 50 % more
    ],
)
def test_every_decision_has_its_reason(returns, flying, age, settings, action, member, reason):
    decision = decide(np.array(returns, dtype=np.float32), flying, age, settings)
    assert (decision.action, decision.member, decision.reason) == (action, member, reason)


def test_every_reason_has_words():
    assert set(REASONS) == set(Reason)


def test_presets_say_what_the_thesis_says():
    thesis = PRESETS["thesis"]
    assert (thesis.model, thesis.prior, thesis.t_play, thesis.horizon) == ("full", "none", 2.0, 2.0)
    assert (thesis.margin, thesis.rho) == (0.5, 0.05)
    understudy = PRESETS["understudy"]
    assert (understudy.model, understudy.prior, understudy.horizon, understudy.margin) == (
        "reduced", "population", 4.0, 0.1,
    )  # fmt: skip


def cast_of(members, rho=0.05):
    members = np.asarray(members, dtype=np.float32)
    return Cast(np.zeros(members.shape[1], np.float32), members, 0, rho), members


def test_a_hard_switch_copies_at_once():
    cast, members = cast_of(np.random.default_rng(0).normal(size=(3, 50)))
    assert np.array_equal(cast.live, members[0])
    cast.take(Decision(Action.HARD, 2, Reason.BETTER, 1.0))
    assert np.array_equal(cast.live, members[2])
    cast.step()
    assert np.array_equal(cast.live, members[2])
    assert cast.flying == 2


def test_a_soft_switch_is_the_polyak_average_and_ends_exactly():
    cast, members = cast_of(np.random.default_rng(1).normal(size=(3, 50)))
    cast.take(Decision(Action.SOFT, 1, Reason.BETTER, 1.0))
    theta = members[0].astype(float)
    for _ in range(100):
        cast.step()
        theta = (1 - 0.05) * theta + 0.05 * members[1]
        np.testing.assert_allclose(cast.live, theta, atol=1e-6)
    assert cast.blend == pytest.approx(0.95**100)
    for _ in range(200):
        cast.step()
    assert cast.blend == 0.0
    assert np.array_equal(cast.live, members[1])


def test_a_blend_is_turned_in_mid_flight_from_where_it_is():
    cast, members = cast_of([[0.0], [1.0], [2.0]], rho=0.5)
    cast.take(Decision(Action.SOFT, 1, Reason.BETTER, 1.0))
    cast.step()
    cast.take(Decision(Action.SOFT, 2, Reason.BETTER, 1.0))
    cast.step()
    np.testing.assert_allclose(cast.live, [0.5 + 0.5 * 1.5])
    cast.take(Decision(Action.KEEP, 0, Reason.MARGIN, 1.0))
    assert cast.flying == 2
    cast.reset()
    assert np.array_equal(cast.live, members[0])


def test_who_flies_first_has_a_head_start_and_is_returned_to():
    start = Adaptation(margin=0.1, head_start=8.0)

    def decided(returns, flying):
        return decide(np.array(returns), flying, 0.1, start, first=0)

    # the first member is left only when more than the head start is at stake
    assert decided([-10.0, -3.0, -10.0], 0).action is Action.KEEP
    assert decided([-20.0, -3.0, -20.0], 0).member == 1
    # and taken again although the incumbent is imagined to be a little better
    back = decided([-10.0, -6.0, -6.0], 1)
    assert (back.action, back.member) == (Action.SOFT, 0)
    assert decided([-20.0, -6.0, -6.0], 1).action is Action.KEEP
    # others have none
    assert decide(np.array([-10.0, -6.0, -6.0]), 1, 0.1, start).action is Action.KEEP
