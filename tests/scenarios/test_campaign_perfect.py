"""Imagination in the aircraft itself: what it foresees is what comes, and who asks flies on as if he had not."""

from __future__ import annotations

import functools

import msgspec
import numpy as np
import pytest

from runtime.config import Operation
from runtime.ensemble import Ensemble
from runtime.guard import Guard
from runtime.identification import IncrementalModel
from runtime.imagination import Snapshot
from runtime.laws.catalogue import load_settings, make_law
from runtime.population import BehaviouralPolicy, load_population
from runtime.presets import resolve
from runtime.switching import Action, Cast, Decision, Reason
from scenarios.campaign import perfect
from scenarios.campaign.design import cells, reference_rows
from scenarios.campaign.flying import Flyer
from scenarios.campaign.perfect import PerfectModel
from scenarios.campaign.rows import Row, choose_rows, known_rows
from scenarios.campaign.store import plain
from scenarios.campaign.suites import load_suite
from sim_bridge.world import World
from task.errors import UserError
from task.limits import DT
from task.observation import tracking_error
from task.reward import CRASH_COST_PER_FRAME, terminated, tracking_reward
from task.state import STATE

HORIZON = 400
ASKED_AT = {"elevator x -1": 30, "commands 100 ms late": 60}
"""Fault, and how many samples after it: the reversal, or the delay, is believed by then."""
REVERSED, LATE = ASKED_AT


@functools.cache
def broken(fault):
    """Return a flight with a fault, with noise, cut soon after what is imagined."""
    found = (c for c in cells(load_suite("hard"), "tuning", 30) if c.fault == fault)
    cell = next(c for c in found if c.sensors == "noise" and c.air == "still" and c.trim == "nominal")
    return msgspec.structs.replace(
        cell,
        flight=msgspec.structs.replace(cell.flight, duration=cell.fault_at + DT * (ASKED_AT[fault] + HORIZON + 50)),
    )


class Flight:
    """The runtime's parts against the aircraft, without a loop: two laws and four linear members."""

    def __init__(self, population, fault=REVERSED, stage=0.0):
        adaptation = resolve("ensemble").adaptation
        cell = broken(fault)
        self.world = World(cell.flight)
        self.rows = reference_rows(cell, float(self.world.x[STATE.theta]))
        network = BehaviouralPolicy(population)
        self.members = [*population.members, *adaptation.laws]
        self.cast = Cast(
            network.parameters, population.parameters, self.members.index(adaptation.first), adaptation.rho
        )
        self.model = IncrementalModel(
            adaptation, population.command_lag, population.theta, population.p0, DT, population.rates,
            population.max_delay, population.learnt_at,
        )  # fmt: skip
        laws = [make_law(name, load_settings(), DT) for name in adaptation.laws]
        self.policy = Ensemble(network, laws, self.cast, self.model)
        self.guard = Guard(Operation())
        for part in (self.cast, self.policy, self.model):
            part.reset()
        self.perfect = PerfectModel(
            self.world, self.policy, self.cast, self.model, self.guard, len(self.members), True, stage
        )
        self.tick = 0

    def fly(self, samples, change=None):
        """Fly on; change to a member in the first sample; return true states (samples, 12)."""
        x = []
        for k in range(samples):
            measured = self.world.measured
            if k or self.tick == 0:
                self.model.observe(measured)
            if k == 0 and change is not None and change != self.cast.flying:
                self.cast.take(Decision(Action.SOFT, change, Reason.BETTER, 0.0))
            self.cast.step()
            action = self.policy.steer(self.model.answered(measured), self.rows[self.tick])
            command, _ = self.guard.command(action)
            self.world.step(command)
            self.model.command(command)
            self.policy.sent(command)
            self.tick += 1
            x.append(self.world.x.copy())
        return np.array(x)

    def ask(self):
        """Return returns and unsafe samples, (P + 1,) each, of a question at the state that has just come."""
        self.model.observe(self.world.measured)
        rows = self.rows[self.tick : self.tick + HORIZON + 1]
        snapshot = Snapshot(**self.model.snapshot()._asdict(), reference=rows, incumbent=self.cast.live)
        self.perfect.request(snapshot, self.tick)
        answer = self.perfect.wait(self.tick)
        return answer.returns[0], answer.unsafe[0]


def to_the_question(population, fault=REVERSED, stage=0.0):
    """Return a flight that has come to the moment of the question."""
    flight = Flight(population, fault, stage)
    flight.fly(round(broken(fault).fault_at / DT) + ASKED_AT[fault])
    return flight


def what_came(population, member, fault=REVERSED):
    """Return the return of flying on with a member, of a flight that never asked."""
    flight = to_the_question(population, fault)
    flight.model.observe(flight.world.measured)
    x, rows = flight.fly(HORIZON, member), flight.rows[flight.tick - HORIZON + 1 : flight.tick + 1]
    lost = np.logical_or.accumulate(terminated(x))
    return np.where(lost, -CRASH_COST_PER_FRAME, tracking_reward(tracking_error(x, rows))).sum(), lost.any()


def test_what_is_foreseen_is_what_comes_and_cutting_off_leaves_the_best_as_it_is(cast, monkeypatch):
    population = load_population(cast)
    flight = to_the_question(population)
    cut, _ = flight.ask()
    monkeypatch.setattr(PerfectModel, "LOOK", 10 * HORIZON)  # nobody is cut off
    whole, _ = to_the_question(population).ask()
    lost = 0
    for member in range(len(flight.members)):
        came, crashed = what_came(population, member)
        assert whole[member] == pytest.approx(came, rel=1e-9)
        lost += crashed
    assert whole[-1] == whole[flight.cast.flying]
    best = int(np.argmax(whole[:-1]))
    assert int(np.argmax(cut[:-1])) == best
    assert cut[best] == pytest.approx(whole[best], rel=1e-12)
    assert cut[-1] == pytest.approx(whole[-1], rel=1e-12)
    assert (cut[:-1] <= cut[best]).all()
    assert 0 < lost < len(flight.members)  # the question was one
    assert whole.max() > 0.2 * whole.min()


def test_members_are_foreseen_to_answer_the_foretold_state_where_commands_are_late(cast, monkeypatch):
    population = load_population(cast)
    monkeypatch.setattr(PerfectModel, "LOOK", 10 * HORIZON)
    flight = to_the_question(population, LATE)
    whole, _ = flight.ask()
    assert flight.model.foretold == 10
    for member in (0, len(population.members)):  # a network and a law
        came, crashed = what_came(population, member, LATE)
        assert not crashed
        assert whole[member] == pytest.approx(came, rel=1e-9)


def test_sequences_are_never_worse_than_one_member(cast, monkeypatch):
    monkeypatch.setattr(PerfectModel, "LOOK", 10 * HORIZON)
    population = load_population(cast)
    one, _ = to_the_question(population).ask()
    two, _ = to_the_question(population, stage=0.5).ask()
    assert (two >= one - 1e-9).all()
    worst = int(np.argmin(one))
    assert two[worst] > 0.5 * one[worst]  # who is lost in the end is left half a second later


def test_asking_changes_nothing(cast):
    never = Row(name="never", preset="ensemble", changes=("margin=1e9",), model="aircraft")
    silent = Row(name="never", preset="ensemble", changes=("switch=none",))
    cell = broken(REVERSED)
    with Flyer(load_population(cast)) as flyer:
        asking, not_asking = (plain(flyer.fly(cell, row)) for row in (never, silent))
    assert asking == not_asking


def test_it_is_chosen_by_name_and_flies(cast):
    row = msgspec.structs.replace(known_rows()["structured-perfect"])
    with Flyer(load_population(cast)) as flyer:
        record = flyer.fly(broken(REVERSED), row)
    assert record.survived
    assert record.switched_to[-1] in ("good/-e", "good/-er")


def test_a_system_that_cannot_fork_is_told_so(cast, monkeypatch):
    monkeypatch.delattr(perfect.os, "fork")
    with pytest.raises(UserError, match="cannot fork"):
        Flight(load_population(cast))


def test_rows_that_take_hours_are_flown_by_name_only():
    usual = {row if isinstance(row, str) else row.name for row in choose_rows(None, ())}
    assert usual >= {"members", "ensemble", "pid"}
    named = choose_rows("ensemble-perfect,ensemble-sequences", ())
    assert not usual & {row.name for row in named}
    assert [row.stage > 0.0 for row in named] == [False, True]
