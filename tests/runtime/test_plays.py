"""When the cast is imagined and what comes of it, with the real imagination of a cast of linear laws."""

import numpy as np
import pytest

from runtime.config import Adaptation
from runtime.identification import IncrementalModel
from runtime.imagination import Imagination
from runtime.plays import Played, Plays
from runtime.population import BehaviouralPolicy, load_population
from runtime.reference import RecordedReference
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
