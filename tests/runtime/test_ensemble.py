"""Classical laws as members of a cast: what the imagination is told of them, and how they take over."""

from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

from runtime.config import Adaptation
from runtime.ensemble import Ensemble
from runtime.hypotheses import hypotheses
from runtime.identification import IncrementalModel
from runtime.laws.catalogue import LAWS, make_law
from runtime.loop import Outcome
from runtime.population import BehaviouralPolicy, load_population
from runtime.presets import resolve
from runtime.reference import RecordedReference
from runtime.session import Session, members_of
from runtime.switching import Action, Cast, Decision, Reason
from sim_bridge.conditions import FlightCondition
from sim_bridge.plant import NOMINAL, Plant
from task.errors import UserError
from task.laws import seen, step
from task.limits import DEFLECTION_LIMIT, DT
from task.metrics import nmae
from task.observation import tracking_error
from task.reference import random_reference
from task.reward import REWARD_SCALE, terminated
from task.state import ACTION, N_IDENTIFIED, REFERENCE, STATE
from tests.runtime.law_flights import ROWS, SETTINGS, flight, reversed_by_now, reversed_elevator

CITATION = Path(__file__).parents[2] / "populations" / "citation"


@pytest.fixture(scope="module")
def citation():
    return load_population(CITATION)


@pytest.mark.parametrize("name", LAWS)
def test_what_the_imagination_is_told_of_a_law_is_what_the_law_does(name):
    """At any moment, and going on from one moment with its own memory for three seconds."""
    told, chained, done, memory = [], [], [], []

    def look(tick, linear, states, sent, action):
        if tick < 5:
            return
        dx = (states[-1] - states[-2])[:N_IDENTIFIED]
        y = seen(states[-1][:N_IDENTIFIED], dx, sent[-2], ROWS[tick], (ROWS[tick] - ROWS[tick - 1]) / DT)
        told.append(step(linear.maps, linear.memory, y)[0])
        done.append(action)
        if tick == 1500:
            memory[:] = [linear.maps, linear.memory]
        if 1500 <= tick < 1800:
            u, memory[1] = step(*memory, y)
            chained.append(u - action)

    flight(make_law(name, SETTINGS), 1800, look=look)
    moved = np.array(done).std(axis=0)
    assert (moved > np.radians(0.05)).all()
    assert (np.abs(np.array(told) - done).mean(axis=0) < 0.05 * moved).all()
    assert (np.abs(np.mean(chained, axis=0)) < 0.1 * moved).all()


def test_a_law_that_starts_again_is_told_to_go_on_as_it_did():
    law = make_law("indi", SETTINGS)
    flight(law, 50)
    law.restart_history()
    linear = law.linear()
    command, _ = step(linear.maps, linear.memory, np.eye(30)[0])
    np.testing.assert_array_equal(command, law._commands[-1])


def test_the_imagination_is_told_of_a_law_as_it_was_told():
    done, told = [], []

    def look(tick, linear, states, sent, action):
        if 515 < tick < 600:
            dx = (states[-1] - states[-2])[:N_IDENTIFIED]
            rate = (ROWS[tick] - ROWS[tick - 1]) / DT
            told.append(
                step(linear.maps, linear.memory, seen(states[-1][:N_IDENTIFIED], dx, sent[-2], ROWS[tick], rate))[0]
            )
            done.append(action)

    flight(make_law("indi", SETTINGS), 600, reversed_elevator, reversed_by_now, look)
    moved = np.array(done).std(axis=0)
    assert (np.abs(np.array(told) - done).mean(axis=0) < 0.05 * moved)[0]


def parts(citation, laws=("indi", "pid")):
    settings = Adaptation(laws=laws)
    network = BehaviouralPolicy(citation)
    cast = Cast(network.parameters, citation.parameters, len(citation.members), 0.05)
    model = IncrementalModel(settings, citation.command_lag, citation.theta, citation.p0)
    return Ensemble(network, [make_law(name, SETTINGS) for name in laws], cast, model), cast


def test_a_soft_change_to_or_from_a_law_steps_no_command(citation):
    ensemble, cast = parts(citation)
    indi, pid, network = len(citation.members), len(citation.members) + 1, citation.champion
    assert cast.law == 0
    plant = Plant()
    x = plant.reset(NOMINAL).copy()
    commands, changes = [], {700: network, 900: indi, 905: pid, 910: network, 1100: indi}
    for tick in range(1400):
        if tick in changes:
            cast.take(Decision(Action.SOFT, changes[tick], Reason.BETTER, 1.0))
        cast.step()
        action = ensemble.steer(x, ROWS[tick]).copy()
        ensemble.sent(action)
        commands.append(action)
        x = plant.step(action).copy()
        assert not terminated(x)
    steps = np.degrees(np.abs(np.diff(commands, axis=0)))
    assert steps[690:].max() < 0.3
    assert cast.law == 0
    assert not cast.handing_over
    assert cast.blend == 0.0
    cast.take(Decision(Action.HARD, pid, Reason.BETTER, 1.0))
    cast.step()
    assert (cast.law, cast.blend) == (1, 0.0)


def test_networks_are_still_averaged_and_laws_never_opposed(citation):
    ensemble, cast = parts(citation)
    cast.take(Decision(Action.HARD, 0, Reason.BETTER, 1.0))
    cast.take(Decision(Action.SOFT, 1, Reason.BETTER, 1.0))
    cast.step()
    expected = 0.95 * citation.parameters[0] + 0.05 * citation.parameters[1]
    np.testing.assert_allclose(ensemble.parameters, expected, atol=1e-6)
    every = np.ones((len(citation.members),) * 2, dtype=bool)
    strict = Cast(ensemble.parameters, citation.parameters, 0, 0.05, every)
    assert strict.opposes(1)
    assert not strict.opposes(len(citation.members))


def test_names_that_do_not_fit_are_refused_in_one_line(citation):
    assert members_of(citation, Adaptation(laws=("pid",)))[-1] == "pid"
    with pytest.raises(UserError, match=r"first: expected one of .*, got 'nobody'"):
        members_of(citation, Adaptation(first="nobody"))
    with pytest.raises(UserError, match="laws"):
        resolve(overrides=("laws=['pid', 'pid']",))
    with pytest.raises(UserError, match=r"brings no laws\.onnx.*--set laws=\[\] --set first=$"):
        citation._replace(laws=None).laws_graph()
    assert resolve("ensemble", None, ("laws=[]", "first=")).adaptation.first == ""


def fly(link, citation, log, *overrides):
    with Session(link, citation, RecordedReference(ROWS), resolve("ensemble", None, overrides), log) as session:
        return session.fly()[0]


def test_an_ensemble_flies_well_and_saves_what_its_laws_lose(citation, plant_link, tmp_path):
    healthy = plant_link(2000)
    flown = fly(healthy, citation, tmp_path / "healthy.ulg")
    assert flown.outcome is Outcome.OVER
    assert nmae(tracking_error(np.array(healthy.x[:2000]), ROWS[:2000])) < 0.5
    assert flown.summary.plays > 5

    def reverse(tick, action):
        return action * np.array([-1.0 if tick >= 1000 else 1.0, 1.0, 1.0])

    # a PID flies first; the elevator reverses
    log = tmp_path / "reversed.ulg"
    saved = plant_link(2500, reverse)
    flown = fly(saved, citation, log, "laws=['pid']", "first=pid")
    assert flown.outcome is Outcome.OVER
    flying = {t.name: t.data for t in ULog(str(log)).data_list}["cycle"]["member"]
    assert flying[999] == len(citation.members)
    assert flying[-1] != flying[999]


def test_a_law_s_imagined_return_is_near_what_it_then_earns(citation, plant_link, tmp_path):
    """A PID on the healthy aircraft, imagined every 2 s, against the 4 s of flight that follow."""
    link = plant_link(3000)
    fly(link, citation, tmp_path / "f.ulg", "laws=['pid']", "first=pid", "head_start=1000")
    play = {t.name: t.data for t in ULog(str(tmp_path / "f.ulg")).data_list}["play"]
    error = np.abs(tracking_error(np.array(link.x[:3000]), ROWS[:3000]))
    reward = -np.clip(error * REWARD_SCALE, 0.0, 1.0).mean(axis=1)
    asked = [t for t in play["tick_asked"] if t + 401 < 3000]
    earned = np.array([reward[t + 1 : t + 401].sum() for t in asked])
    imagined = play[f"returns[{len(citation.members)}]"][: len(asked)]
    assert len(asked) > 8
    assert np.abs(imagined - earned).mean() < 0.1 * np.abs(earned).mean()


AGGRESSIVE = random_reference(np.random.default_rng(3), 25.0, ROWS[0, REFERENCE.theta], "aggressive")


def topic(log, name):
    return {t.name: t.data for t in ULog(str(log)).data_list}[name]


def fly_rows(link, citation, log, *overrides, preset="ensemble"):
    with Session(link, citation, RecordedReference(AGGRESSIVE), resolve(preset, None, overrides), log) as session:
        return session.fly()[0]


def test_an_elevator_that_stops_short_is_known_and_not_taken_for_a_late_one(citation, plant_link, tmp_path):
    ends = np.radians([-2.0, 2.0])

    def stop(tick, action):
        return np.array([np.clip(action[0], *ends), *action[1:]]) if tick >= 500 else action

    link, log = plant_link(2400, stop), tmp_path / "f.ulg"
    assert fly_rows(link, citation, log).outcome is Outcome.OVER
    found = topic(log, "effectiveness")
    choices = hypotheses(resolve("ensemble").adaptation, DT)
    assert choices[found["hypothesis"][-1]].limited == ACTION.de
    assert (found["delay"][500:] == 0).all()
    plain, other = plant_link(2400, stop), tmp_path / "g.ulg"
    assert fly_rows(plain, citation, other, "ranges=false").outcome is Outcome.OVER

    def error(states):
        return nmae(tracking_error(np.array(states.x[500:2400]), AGGRESSIVE[500:2400]))

    # What the elevator does not reach is out of reach for both.
    assert error(link) == pytest.approx(error(plain), rel=0.01)
    assert found["alarms"][-1] < topic(other, "effectiveness")["alarms"][-1]


@pytest.mark.parametrize(("preset", "samples"), [("ensemble", 10), ("ensemble", 15), ("structured", 15)])
def test_late_commands_are_made_up_for_once_they_are_known(citation, plant_link, tmp_path, preset, samples):
    def error(*overrides):
        sent = []

        def late(tick, action):
            sent.append(action.copy())
            return sent[max(tick - samples * (tick >= 500), 0)]

        link, log = plant_link(2400, late), tmp_path / f"{len(overrides)}.ulg"
        assert fly_rows(link, citation, log, *overrides, preset=preset).outcome is Outcome.OVER
        assert topic(log, "effectiveness")["delay"][-1] == samples
        return nmae(tracking_error(np.array(link.x[500:2400]), AGGRESSIVE[500:2400]))

    assert error() < 0.5 * error("foretell=false")


def test_an_aileron_that_oscillates_is_known_and_not_taken_for_one_that_works_otherwise(citation, plant_link, tmp_path):
    def swing(tick, action):
        return action + np.array([0.0, np.radians(3.0) * np.sin(2.0 * np.pi * (tick - 500) * DT), 0.0]) * (tick >= 500)

    found = {}
    for name, overrides in {"as it is": (), "without": ("q_uncommanded=0",)}.items():
        link, log = plant_link(2000, swing), tmp_path / f"{name}.ulg"
        assert fly_rows(link, citation, log, *overrides).outcome is Outcome.OVER
        found[name] = topic(log, "effectiveness")
    choices, known = hypotheses(resolve("ensemble").adaptation, DT), found["as it is"]
    assert {choices[i].uncommanded for i in known["hypothesis"][600:]} == {ACTION.da}
    assert np.ptp(known["lambda_da"][600:]) == 0.0
    assert 0 < known["alarms"][-1] <= 2
    others = found["without"]
    assert others["alarms"][-1] > 5
    assert np.ptp(others["lambda_da"][600:]) > 0.5


def test_who_flies_reads_filtered_rates_where_a_gyro_is_stuck(citation, plant_link, tmp_path):
    def error(stuck, *overrides):
        held = []

        def read(tick, x):
            if stuck and tick >= 500:
                held.append(x[STATE.p])
                x[STATE.p] = held[0]
            return x

        link = plant_link(2400, state=read)
        outcome = fly_rows(link, citation, tmp_path / "f.ulg", *overrides).outcome
        flown = np.array(link.x[500:2400])
        return outcome, nmae(tracking_error(flown, AGGRESSIVE[500 : 500 + len(flown)]))

    outcome, healthy = error(False)
    assert outcome is Outcome.OVER
    outcome, mended = error(True)
    assert outcome is Outcome.OVER
    assert mended < 1.2 * healthy
    # Without the filter it reads what the gyro says.
    outcome, misled = error(True, "effectiveness=none")
    assert outcome is Outcome.LOST or misled > 1.5 * healthy


def test_a_surface_that_reverses_at_its_limit_is_found_by_moving_it_and_only_so(citation, plant_link, tmp_path):
    """Near the stall all of the elevator is asked for when it reverses (``scenarios/reversed_at_limit.toml``)."""
    fault, end = 1800, 2600
    gyros = np.random.default_rng(0)

    def reverse(tick, action):
        return action * [-1.0, 1.0, 1.0] if tick >= fault else action

    def noisy(tick, x):
        x[[STATE.p, STATE.q, STATE.r]] += 6.3e-4 * gyros.standard_normal(3)
        return x

    def fly(name, *overrides):
        link, log = plant_link(end, reverse, noisy), tmp_path / f"{name}.ulg"
        link.plant.reset(FlightCondition(altitude=10000.0, speed=90.0))
        rows = random_reference(np.random.default_rng(2), 40.0, float(link.plant.x[STATE.theta]), "aggressive")
        with Session(link, citation, RecordedReference(rows), resolve("ensemble", None, overrides), log) as session:
            return session.fly()[0], np.array(link.sent), topic(log, "effectiveness")

    flown, sent, found = fly("excited")
    assert flown.outcome is Outcome.OVER
    assert 0 < flown.summary.pulses < 10
    excited = np.flatnonzero(found["excited"])
    assert fault < excited[0] < fault + 10
    np.testing.assert_allclose(sent[excited[0], 0], np.radians(-5.0), atol=1e-6)
    assert found["lambda_de"][fault + 50] < -0.7
    plain, sent, found = fly("plain", "excitation=0")
    assert plain.summary.pulses == 0
    assert not found["excited"].any()
    # Then the command does not move for a second, and nobody learns what it does; who survives that has been lucky.
    assert (sent[fault : fault + 100, 0] == -DEFLECTION_LIMIT).mean() > 0.9
    assert np.median(found["lambda_de"][fault + 10 : fault + 100]) > -0.6
