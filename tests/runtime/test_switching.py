import numpy as np
import pytest

from runtime.config import Adaptation
from runtime.presets import PRESETS
from runtime.switching import REASONS, Action, Cast, Decision, Reason, decide, opposed

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


def test_reasons_and_actions_are_the_numbers_that_logs_hold():
    assert [reason.name for reason in sorted(Reason)] == [
        "SWITCHED_OFF", "BETTER", "MARGIN", "INCUMBENT_IS_BEST", "TOO_OLD", "NO_PREDICTION", "INCUMBENT_UNKNOWN",
        "OVERTAKEN", "DWELL", "UNCONFIRMED",
    ]  # fmt: skip
    assert sorted(Reason) == list(range(10))
    assert (Action.KEEP, Action.HARD, Action.SOFT) == (0, 1, 2)


BETTER = np.array([-40.0, -60.0, -100.0])
"""The first of two members is better than what flies by more than any margin here."""


def test_a_prediction_decides_up_to_max_age_and_a_switch_comes_no_sooner_than_dwell_after_the_last():
    settings = Adaptation(margin=0.5, prior="none", max_age=1.0, dwell=2.0)
    assert decide(BETTER, 1, 1.0, settings, 2.0).reason is Reason.BETTER
    assert decide(BETTER, 1, 1.001, settings, 2.0).reason is Reason.TOO_OLD
    assert decide(BETTER, 1, 1.0, settings, 1.999).reason is Reason.DWELL
    assert decide(BETTER, 0, 1.0, settings, 1.0).reason is Reason.INCUMBENT_IS_BEST
    for of in (decide(BETTER, 1, 1.001, settings, 2.0), decide(BETTER, 1, 1.0, settings, 1.999)):
        assert (of.action, of.member, of.lead) == (Action.KEEP, 0, 60.0)


@pytest.mark.parametrize(
    ("returns", "age"), [([-40.0, -60.0, -100.0], 0.1), ([-40.0, -60.0, -100.0], 9.0), ([NAN, NAN, NAN], 0.1)]
)
def test_what_an_alarm_has_overtaken_decides_nothing_whatever_else_is_wrong_with_it(returns, age):
    decision = decide(np.array(returns), 1, age, SOFT, overtaken=True)
    assert (decision.action, decision.reason) == (Action.KEEP, Reason.OVERTAKEN)


def test_an_incumbent_that_is_not_known_is_still_not_replaced_before_dwell_is_over():
    settings = Adaptation(prior="none", dwell=2.0)
    assert decide(np.array([-40.0, -60.0, NAN]), 1, 0.1, settings, 1.0).reason is Reason.DWELL
    hard = Adaptation(switch="hard", prior="none", dwell=2.0)
    assert decide(np.array([-40.0, -60.0, NAN]), 1, 0.1, hard, 2.0).action is Action.HARD


def test_the_lead_is_that_of_the_best_member_and_unknown_where_either_is():
    assert decide(BETTER, 1, 0.1, SOFT).lead == 60.0
    for returns in ([NAN, -np.inf, -200.0], [-40.0, -60.0, NAN], [-40.0, -60.0, -np.inf]):
        assert np.isnan(decide(np.array(returns), 1, 0.1, SOFT).lead)


@pytest.mark.parametrize(("flying", "lead"), [(0, 1.0 - 5.0), (1, 1.0)])
def test_the_head_start_counts_for_the_incumbent_when_it_is_the_first_that_flies(flying, lead):
    start, returns = Adaptation(head_start=5.0), np.array([-9.0, -3.0, -4.0])
    decision = decide(returns, flying, 0.1, start, first=0)
    assert (decision.member, decision.lead) == (1, lead)
    assert returns.tolist() == [-9.0, -3.0, -4.0]


def test_the_last_member_may_be_the_first_to_fly():
    start = Adaptation(margin=0.1, head_start=8.0)
    assert decide(np.array([-6.0, -10.0, -6.0]), 0, 0.1, start, first=1).member == 1
    assert decide(np.array([-6.0, -10.0, -6.0]), 0, 0.1, start, first=-1).member == 0


def test_members_are_opposed_whose_commands_on_any_one_surface_are_more_unlike_than_at_120_degrees():
    at = {"same": 0.0, "square": 90.0, "just not": 119.9, "just": 120.1, "mirror": 180.0}
    commands = np.zeros((len(at) + 1, 2, 3))
    for i, angle in enumerate(np.radians(list(at.values()))):
        commands[i, :, 2] = 0.1 * (i + 1) * np.array([np.cos(angle), np.sin(angle)])
    commands[:, 0, 0] = 0.2  # elevators agree
    table = opposed(commands)
    np.testing.assert_array_equal(table, table.T)
    assert table[0].tolist() == [False, False, False, True, True, False]
    assert not table[-1].any()  # who commands nothing on a surface agrees with everybody


def mixed_cast(opposes=None):
    """Return a cast of three networks and two laws of which the first network flies."""
    members = np.array([[0.0], [1.0], [2.0]], dtype=np.float32)
    return Cast(np.zeros(1, np.float32), members, 0, 0.5, opposes), members


def test_a_member_is_opposed_to_what_flies_and_during_a_blend_to_what_it_comes_from():
    table = np.zeros((3, 3), dtype=bool)
    table[0, 2] = table[2, 0] = True
    cast, _ = mixed_cast(table)
    assert [cast.opposes(member) for member in range(5)] == [False, False, True, False, False]
    cast.take(Decision(Action.SOFT, 1, Reason.BETTER, 1.0))
    assert cast.opposes(2)  # the blend comes from 0
    while cast.blend > 0.0:
        cast.step()
    assert not cast.opposes(2)
    cast.take(Decision(Action.HARD, 3, Reason.BETTER, 1.0))
    assert not any(cast.opposes(member) for member in range(5))
    cast.take(Decision(Action.SOFT, 1, Reason.BETTER, 1.0))
    assert not cast.opposes(2)  # what it comes from is a law
    assert not mixed_cast()[0].opposes(2)


def test_a_law_has_a_number_of_its_own_and_leaves_the_network_s_parameters_alone():
    cast, members = mixed_cast()
    assert cast.law is None
    for member, law in ((3, 0), (4, 1)):
        cast.take(Decision(Action.HARD, member, Reason.BETTER, 1.0))
        assert (cast.flying, cast.law) == (member, law)
        assert cast.live == members[0]
    cast.take(Decision(Action.HARD, 2, Reason.BETTER, 1.0))
    assert cast.law is None
    assert cast.live == members[2]


@pytest.mark.parametrize(("origin", "to"), [(0, 3), (3, 1), (3, 4)])
def test_a_soft_change_from_or_to_a_law_hands_actions_over_from_the_sample_after(origin, to):
    cast, members = mixed_cast()
    cast.take(Decision(Action.HARD, origin, Reason.BETTER, 1.0))
    cast.take(Decision(Action.SOFT, to, Reason.BETTER, 1.0))
    assert (cast.handing_over, cast.taken, cast.blend) == (True, True, 1.0)
    if to < 3:
        assert cast.live == members[to]  # at once: it is the action that moves
    live = cast.live.copy()
    cast.step()
    assert cast.blend == 1.0
    cast.taken = False
    blends = []
    while cast.handing_over:
        cast.step()
        blends.append(cast.blend)
    np.testing.assert_array_equal(blends, [*0.5 ** np.arange(1, 20), 0.0])  # until less than a millionth is left
    assert cast.live == live


def test_a_change_while_actions_are_handed_over_is_handed_over_too():
    cast, members = mixed_cast()
    cast.take(Decision(Action.SOFT, 3, Reason.BETTER, 1.0))
    cast.take(Decision(Action.SOFT, 1, Reason.BETTER, 1.0))
    cast.taken = False
    cast.take(Decision(Action.SOFT, 2, Reason.BETTER, 1.0))  # of two networks
    assert (cast.handing_over, cast.taken) == (True, True)
    assert cast.live == members[2]
    cast.take(Decision(Action.HARD, 1, Reason.BETTER, 1.0))
    assert (cast.handing_over, cast.taken, cast.blend) == (False, False, 0.0)
    assert cast.live == members[1]


def test_a_new_flight_begins_with_the_first_member_and_no_change_under_way():
    cast, members = mixed_cast()
    cast.take(Decision(Action.SOFT, 3, Reason.BETTER, 1.0))
    cast.reset()
    assert (cast.flying, cast.law, cast.blend, cast.handing_over, cast.taken) == (0, None, 0.0, False, False)
    assert cast.live == members[0]


def test_a_blend_of_parameters_ends_when_less_than_a_millionth_is_left():
    cast, members = mixed_cast()
    cast.take(Decision(Action.SOFT, 2, Reason.BETTER, 1.0))
    assert not cast.handing_over
    steps = 0
    while cast.blend > 0.0:
        cast.step()
        steps += 1
    assert steps == 20
    assert cast.live == members[2]
