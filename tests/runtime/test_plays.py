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
