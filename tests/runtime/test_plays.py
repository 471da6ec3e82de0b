"""When the cast is imagined and what comes of it, with the real imagination of a cast of linear laws."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from runtime.config import Adaptation
from runtime.identification import IncrementalModel
from runtime.imagination import Imagination, Prediction
from runtime.plays import Played, Plays
from runtime.population import BehaviouralPolicy, load_population
from runtime.reference import LiveReference, RecordedReference
from runtime.switching import Action, Cast, Decision, Reason
from task.limits import DT
from task.state import STATE

SETTINGS = Adaptation(identify=False, t_play=0.2, horizon=1.0, play_delay_ticks=3)
MEMBERS = ["good", "lazy", "strong", "mirror"]


@pytest.fixture(scope="module")
def population(cast_folder):
    return load_population(cast_folder)


class Flight:
    """Everything that plays, and a level flight to play from."""

    def __init__(self, population, imagination, settings=SETTINGS, flying="good"):
        self.cast = Cast(BehaviouralPolicy(population).parameters, population.parameters, MEMBERS.index(flying), 0.05)
        self.model = IncrementalModel(
            settings, population.command_lag, population.theta, population.p0, max_delay=population.max_delay
        )
        reference = RecordedReference(np.tile([0.156, 0.1, 0.0], (2000, 1)))
        self.plays = Plays(imagination, self.model, self.cast, reference, settings, DT, lockstep=True)
        self.x = np.zeros(12)
        self.x[[STATE.V, STATE.h, STATE.alpha, STATE.theta]] = 90.0, 2000.0, 0.056, 0.056

    def fly(self, ticks):
        """Return what was decided, by tick."""
        decided = {}
        for tick in range(ticks):
            self.model.observe(self.x)
            played = self.plays.step(tick, tick * DT)
            if played is not None:
                decided[tick] = played
            self.model.command(np.array([-0.02477, 0.0, 0.0]))
        return decided


@pytest.fixture
def imagination(population):
    with Imagination(population, 100) as imagination:
        yield imagination


def test_it_asks_every_period_and_decides_when_the_delay_is_over(population, imagination):
    flight = Flight(population, imagination)
    decided = flight.fly(70)
    assert list(decided) == [23, 43, 63]
    assert [played.tick_asked for played in decided.values()] == [20, 40, 60]
    assert all(played.age == pytest.approx(0.03) for played in decided.values())
    assert flight.plays.asked == 3
    assert flight.plays.failed == flight.plays.skipped == 0
    for played in decided.values():
        assert played.returns.shape == played.unsafe.shape == (len(MEMBERS) + 1,)
        assert played.returns[-1] == pytest.approx(played.returns[0], rel=1e-5)  # the incumbent is the first member


def test_a_member_that_is_imagined_to_lose_the_aircraft_is_left(population, imagination):
    decided = Flight(population, imagination, flying="mirror").fly(30)
    decision = decided[23].decision
    assert decision.action is Action.SOFT
    assert MEMBERS[decision.member] in ("good", "strong")
    assert decision.reason is Reason.BETTER


def test_a_switch_in_words():
    returns = np.array([-10.0, -5.5, -20.0])
    decision = Decision(Action.HARD, 1, Reason.BETTER, 14.5)
    safe = Played(returns, np.zeros(3), 0.1, 0, decision, "").describe(["a", "b"])
    assert safe == (
        "hard switch to b: predicted -5.5, incumbent -20.0 "
        "(another member is predicted to fly better by more than the margin)"
    )
    risky = Played(returns, np.array([0.0, 0.42, 0.0]), 0.1, 0, decision, "").describe(["a", "b"])
    assert "switch to b: predicted -5.5 with 0.42 s unsafe, incumbent" in risky


class Foretold:
    """An imagination that says what it is told to, by the tick of the question; the rest is the last of it."""

    def __init__(self, returns, travel=0.0):
        self.returns, self.travel = list(returns), travel

    def request(self, snapshot, tick):
        """Take a question."""
        self.question = snapshot

    def wait(self, asked):
        returns = self.returns.pop(0) if len(self.returns) > 1 else self.returns[0]
        travel = np.broadcast_to(self.travel, (1, len(returns)))
        return Prediction(np.array([returns]), np.zeros((1, len(returns))), travel, asked, 0.001)


@pytest.mark.parametrize(
    ("cost", "free", "paid", "flies"),
    [
        (0.0, 0.0, (2.0, 20.0), "strong"),
        (0.05, 0.0, (2.0, 20.0), "strong"),
        (0.1, 0.0, (2.0, 20.0), "good"),
        (0.1, 10.0, (0.0, 10.0), "strong"),  # rad/s, over a horizon of one second
        (0.2, 10.0, (0.0, 10.0), "good"),
    ],
)
def test_surface_travel_costs_what_the_settings_say(population, cost, free, paid, flies):
    """The strong member tracks a third closer and moves its surfaces by 20 rad, the good one by 2."""
    settings = msgspec.structs.replace(SETTINGS, travel_cost=cost, travel_free=free)
    flight = Flight(population, None, settings)
    flight.plays._imagination = Foretold([[-4.0, -90.0, -2.6, -90.0, -4.0]], [2.0, 1.0, 20.0, 1.0, 2.0])
    (decided,) = flight.fly(30).values()
    assert decided.returns[[0, 2]] == pytest.approx([-4.0 - paid[0] * cost, -2.6 - paid[1] * cost])
    assert MEMBERS[decided.decision.member] == flies


HARD, QUIET = [-40.0, -20.0, -90.0, -90.0], [-1.0, -2.0, -90.0, -90.0]
"""What "good", "lazy" and the others are foretold in a hard moment and in a quiet one."""


def foretell(population, settings, foretold, alarm_at=-1):
    """Return what comes of returns that are foretold while "good" flies."""
    flight = Flight(population, None, settings, "good")
    flight.cast.first = MEMBERS.index("good")
    found = SimpleNamespace(believed=np.ones(3), evidence=SimpleNamespace(believed=0))
    model = SimpleNamespace(alarmed=False, ready=True, rls=SimpleNamespace(updates=0), effectiveness=found)
    plays = flight.plays
    plays._model, plays._snapshot = model, lambda t: None
    plays._imagination = Foretold([*row, row[MEMBERS.index("good")]] for row in foretold)
    decided = []
    for tick in range(100):
        model.alarmed = tick == alarm_at
        if played := plays.step(tick, tick * DT):
            decided.append(played)
    return decided


@pytest.mark.parametrize(
    ("head_start", "memory", "foretold", "expected"),
    [
        (25.0, 0.0, [HARD], "good"),
        (0.5, 0.0, [HARD], "lazy"),
        (0.5, 0.0, [HARD, QUIET, QUIET, QUIET], "good"),
        (0.5, 3.0, [HARD, QUIET, QUIET, QUIET], "lazy"),  # the hard moment is remembered
        (0.0, 0.0, [[-1.0, -0.8, -90.0, -90.0]], "lazy"),
        (0.5, 0.0, [[-1.0, -0.8, -90.0, -90.0]], "good"),
    ],
)
def test_who_flies_first_has_a_head_start_and_returns_are_remembered(
    population, head_start, memory, foretold, expected
):
    settings = msgspec.structs.replace(SETTINGS, head_start=head_start, forecast_time=memory)
    assert MEMBERS[foretell(population, settings, foretold)[-1].decision.member] == expected


@pytest.mark.parametrize(("needed", "reasons"), [(1, [Reason.BETTER]), (2, [Reason.UNCONFIRMED, Reason.BETTER])])
def test_after_an_alarm_as_many_imaginations_must_agree_as_are_asked_for(population, needed, reasons):
    settings = msgspec.structs.replace(SETTINGS, confirmations=2, confirmations_watch=needed, watch=0.5)
    played = foretell(population, settings, [HARD], alarm_at=12)
    assert [p.decision.reason for p in played[:needed]] == reasons
    assert [MEMBERS[p.decision.member] for p in played[:needed]] == ["lazy"] * needed
    asked = [p.tick_asked for p in played[:needed]]
    assert asked[0] == 12 + round(settings.settle / DT)
    assert asked[1:] == [asked[0] + settings.play_delay_ticks] * (needed - 1)  # the second is asked for at once


@pytest.mark.parametrize("settle", [0.0, 0.08])
def test_what_an_alarm_asks_for_decides_however_soon_it_is_asked(population, settle):
    settings = msgspec.structs.replace(SETTINGS, settle=settle, watch=0.5)
    played = {each.tick_asked: each.decision.reason for each in foretell(population, settings, [HARD], alarm_at=21)}
    assert played.get(20, Reason.OVERTAKEN) is Reason.OVERTAKEN
    assert played[21 + round(settle / DT)] is Reason.BETTER


def test_an_alarm_does_not_hasten_what_chance_says(population):
    settings = msgspec.structs.replace(SETTINGS, confirmations=2, confirmations_watch=2, watch=0.5)
    played = foretell(population, settings, [HARD, QUIET, HARD, QUIET, QUIET], alarm_at=12)
    assert all(p.decision.action is Action.KEEP for p in played)


RAMP = np.column_stack([0.1 + 0.1 * DT * np.arange(2000), np.zeros(2000), np.zeros(2000)])
"""Pitch goes up by 0.1 rad/s."""


def asked_about(population, settings, reference, ticks=41):
    """Return the pitch of the last question's reference, 1 s from tick 40 on; live set-points follow RAMP."""
    flight = Flight(population, None, settings)
    flight.plays._imagination = Foretold([[-1.0] * 5])
    flight.plays._reference = reference
    for tick in range(ticks):
        if isinstance(reference, LiveReference):
            reference.set(*RAMP[tick, :2])
        flight.model.observe(flight.x)
        flight.plays.step(tick, tick * DT)
        flight.model.command(np.array([-0.02477, 0.0, 0.0]))
    return flight.plays._imagination.question.reference[:, 0]


@pytest.mark.parametrize("preview", [True, False])
@pytest.mark.parametrize("live", [True, False])
def test_what_is_not_known_of_the_reference_goes_on_as_it_moves(population, preview, live):
    settings = msgspec.structs.replace(SETTINGS, preview=preview, trend_time=0.5)
    pitch = asked_about(population, settings, LiveReference() if live else RecordedReference(RAMP))
    assert pitch.shape == (101,)
    assert pitch[0] == pytest.approx(0.14)
    goes = 0.1 if preview and not live else 0.1 * 0.5 * (1.0 - np.exp(-1.0 / 0.5))
    assert pitch[100] - pitch[0] == pytest.approx(goes, rel=1e-4)


def test_without_trend_what_is_not_known_is_held(population):
    settings = msgspec.structs.replace(SETTINGS, preview=False)
    np.testing.assert_allclose(asked_about(population, settings, RecordedReference(RAMP)), 0.14, rtol=1e-6)


class Late(Foretold):
    """An imagination that is not there until it is told to be, as in real time."""

    there = False

    def result(self, asked):
        return self.wait(asked) if self.there else None


def real_time(population, settings, foretold=(-1.0, -0.2, -90.0, -90.0, -1.0)):
    flight = Flight(population, None, settings)
    plays = flight.plays
    plays._lockstep, plays._imagination = False, Late([list(foretold)])
    return flight, plays


def test_in_real_time_nothing_else_is_asked_for_while_one_is_under_way_and_it_decides_when_it_is_there(population):
    flight, plays = real_time(population, msgspec.structs.replace(SETTINGS, max_age=0.5))
    decided = {}
    for tick in range(80):
        plays._imagination.there = tick >= 53
        flight.model.observe(flight.x)
        if played := plays.step(tick, tick * DT):
            decided[tick] = played
        flight.model.command(np.array([-0.02477, 0.0, 0.0]))
    assert list(decided) == [53, 61]
    assert (decided[53].tick_asked, decided[53].age) == (20, pytest.approx(0.33))
    assert (decided[61].tick_asked, decided[61].age) == (60, pytest.approx(0.01))
    assert (plays.asked, plays.skipped, plays.failed) == (2, 1, 0)
    assert plays.seconds == [0.001, 0.001]


def test_an_imagination_that_comes_after_max_age_decides_nothing(population):
    for age, reason in ((0.33, Reason.BETTER), (0.32, Reason.TOO_OLD)):
        flight, plays = real_time(population, msgspec.structs.replace(SETTINGS, max_age=age + 1e-9))
        for tick in range(54):
            plays._imagination.there = tick == 53
            flight.model.observe(flight.x)
            played = plays.step(tick, tick * DT)
            flight.model.command(np.array([-0.02477, 0.0, 0.0]))
        assert played.decision.reason is reason


def test_an_alarm_asks_anew_though_a_question_is_under_way_and_that_one_decides_no_more(population):
    settings = msgspec.structs.replace(SETTINGS, settle=0.02, watch=0.1, watch_period=0.05, play_delay_ticks=10)
    played = foretell(population, settings, [HARD], alarm_at=25)
    # 20 is given up for 27; at 32 that one is under way
    assert [each.tick_asked for each in played] == [27, 37, 60, 80]


def test_after_an_alarm_imaginations_follow_each_other_for_watch_and_then_at_their_usual_times(population):
    settings = msgspec.structs.replace(SETTINGS, settle=0.03, watch=0.2, watch_period=0.06)
    asked = [each.tick_asked for each in foretell(population, settings, [QUIET], alarm_at=21)]
    assert asked == [20, 24, 30, 36, 42, 48, 60, 80]


@pytest.mark.parametrize(("confirmations", "switched"), [(1, [20, 40, 60, 80]), (2, [20, 23, 40, 43, 60, 63, 80, 83])])
def test_what_must_be_confirmed_is_asked_for_again_at_once(population, confirmations, switched):
    settings = msgspec.structs.replace(SETTINGS, confirmations=confirmations)
    played = foretell(population, settings, [HARD])
    assert [p.tick_asked for p in played] == switched
    assert [p.decision.reason for p in played[:confirmations]] == [Reason.UNCONFIRMED] * (confirmations - 1) + [
        Reason.BETTER
    ]


def test_another_member_named_in_between_is_counted_from_one(population):
    other = [-40.0, -90.0, -20.0, -90.0]
    settings = msgspec.structs.replace(SETTINGS, confirmations=2)
    reasons = [p.decision.reason for p in foretell(population, settings, [HARD, other, HARD, HARD])[:4]]
    assert reasons == [Reason.UNCONFIRMED] * 3 + [Reason.BETTER]


@pytest.mark.parametrize("found", [True, False])
def test_a_member_that_opposes_needs_two_without_an_alarm_and_is_switched_to_hard(population, found):
    flight = Flight(population, None, msgspec.structs.replace(SETTINGS, dwell=0.0))
    flight.cast.opposes = lambda member: True
    effectiveness = SimpleNamespace(believed=np.ones(3), evidence=SimpleNamespace(believed=0)) if found else None
    plays = flight.plays
    plays._model = SimpleNamespace(
        alarmed=False, ready=True, rls=SimpleNamespace(updates=0), effectiveness=effectiveness
    )
    plays._snapshot, plays._imagination = lambda t: None, Foretold([[*HARD, HARD[0]]])
    played = [each for tick in range(50) if (each := plays.step(tick, tick * DT))]
    decisions = [(p.decision.action, p.decision.reason) for p in played[:2]]
    assert decisions[0] == ((Action.KEEP, Reason.UNCONFIRMED) if found else (Action.HARD, Reason.BETTER))
    assert decisions[1] == (Action.HARD, Reason.BETTER)
    assert [p.tick_asked for p in played[:2]] == [20, 40]  # the second is not asked for any sooner


def test_no_switch_comes_sooner_than_dwell_after_the_last(population):
    settings = msgspec.structs.replace(SETTINGS, dwell=0.35)
    played = foretell(population, settings, [HARD])
    assert [p.decision.reason for p in played] == [Reason.BETTER, Reason.DWELL, Reason.BETTER, Reason.DWELL]


def test_an_imagination_that_fails_is_counted_and_the_next_one_is_asked_for(population):
    flight = Flight(population, None)

    class Fails:
        def request(self, snapshot, tick):
            pass

        def wait(self, asked):
            if asked == 20:
                return None
            nothing = np.full((1, 5), np.nan)
            return Prediction(nothing, np.zeros((1, 5)), np.zeros((1, 5)), asked, 0.5, "no memory")

    flight.plays._imagination = Fails()
    decided = flight.fly(50)
    assert list(decided) == [43]
    assert decided[43].error == "no memory"
    assert decided[43].decision.reason is Reason.NO_PREDICTION
    assert (flight.plays.asked, flight.plays.failed, flight.plays.seconds) == (2, 2, [0.5])


def test_without_a_prior_nothing_is_imagined_before_as_many_samples_as_the_model_has_rows(population):
    settings = msgspec.structs.replace(SETTINGS, prior="none", identify=True)
    flight = Flight(population, None, settings)
    plays = flight.plays
    rows = len(flight.model.rls.Theta)
    plays._model = SimpleNamespace(alarmed=False, ready=True, rls=SimpleNamespace(updates=0), effectiveness=None)
    plays._snapshot, plays._imagination = lambda t: None, Foretold([[*QUIET, QUIET[0]]])
    for tick in range(100):
        plays._model.rls.updates = rows - (tick < 33)
        plays.step(tick, tick * DT)
        assert plays.asked == (tick >= 33) + (tick >= 40) + (tick >= 60) + (tick >= 80)
    with_prior = Flight(population, None).plays
    assert with_prior._least_updates == 0


def test_what_a_play_says_is_the_mean_of_the_models_and_unsafe_in_seconds(population):
    flight = Flight(population, None)

    class Several(Foretold):
        def wait(self, asked):
            returns = np.array([[-2.0, -4.0, -9.0, -9.0, -2.0], [-4.0, -2.0, -9.0, -9.0, -4.0]])
            unsafe = np.array([[0.0, 10.0, 0.0, 0.0, 4.0], [20.0, 10.0, 0.0, 0.0, 0.0]])
            return Prediction(returns, unsafe, np.zeros((2, 5)), asked, 0.001)

    flight.plays._imagination = Several([])
    (played,) = flight.fly(30).values()
    np.testing.assert_allclose(played.returns, [-3.0, -3.0, -9.0, -9.0, -3.0])
    np.testing.assert_allclose(played.unsafe, [0.1, 0.1, 0.0, 0.0, 0.02])
