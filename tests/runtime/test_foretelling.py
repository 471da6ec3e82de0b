"""Late commands: the state is foretold for when the answer acts, and whoever flies answers that one."""

import msgspec
import numpy as np
import pytest

from runtime.foretelling import foretell
from runtime.identification import IncrementalModel
from runtime.presets import resolve
from task.limits import DT
from task.model import embed_reduced, predict_increment
from task.state import N_ACTION, N_IDENTIFIED, STATE
from tests.runtime.rate_aircraft import MODEL, Aircraft

LAG = 1
SETTINGS = msgspec.structs.replace(resolve("ensemble").adaptation, prior="population", identify=False)


def reduced_model() -> np.ndarray:
    rng = np.random.default_rng(4)
    theta = np.zeros((11, 6))
    theta[:6] = 0.95 * np.eye(6) + 0.01 * rng.normal(size=(6, 6))
    theta[8:] = 0.1 * rng.normal(size=(N_ACTION, 6))
    return theta


@pytest.mark.parametrize("delay", [1, 5, 15])
def test_the_foretold_state_is_what_comes_with_the_commands_that_wait(delay):
    rng, theta = np.random.default_rng(5), embed_reduced(reduced_model())
    commands = 0.02 * rng.normal(size=(60, N_ACTION))
    x, dx = np.zeros(N_IDENTIFIED), 1e-3 * rng.normal(size=N_IDENTIFIED)
    x[STATE.V], x[STATE.h] = 90.0, 2000.0
    states, increments = [x], [dx]
    for k in range(40):  # a command that answers state k moves x[k + LAG + 1 + delay]
        sent = [max(k - LAG - delay - i, 0) for i in range(2)]
        dx = predict_increment(x, dx, commands[sent[0]] - commands[sent[1]], theta, True)
        x = x + dx
        states.append(x)
        increments.append(dx)
    k = 25
    sent = commands[k - LAG - 1 - delay : k]
    ahead, moved = foretell(states[k], increments[k], sent, delay, LAG, theta, True, DT)
    np.testing.assert_allclose(ahead, states[k + delay], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(moved, increments[k + delay], rtol=0.0, atol=1e-12)


def model_that_believes(delay: float, **changes: object) -> tuple[IncrementalModel, np.ndarray]:
    """Return a model that has seen a second of flight and believes commands to be late [s], and its last state."""
    settings = msgspec.structs.replace(SETTINGS, **changes)
    model = IncrementalModel(settings, LAG, reduced_model(), np.eye(11), DT, MODEL, max_delay=20)
    aircraft = Aircraft()
    for _ in range(100):
        x = aircraft.read()
        model.observe(x)
        u = aircraft.command()
        model.command(u)
        aircraft.step(u)
    model.observe(x := aircraft.read())
    late = [each.delay for each in model.effectiveness.hypotheses]
    model.effectiveness.evidence.believed = late.index(round(delay / DT))
    return model, x


def test_whoever_flies_answers_the_state_at_which_the_answer_acts():
    model, x = model_that_believes(0.10)
    assert model.foretold == 10
    snapshot = model.snapshot()
    assert snapshot.delay == 0  # the cast is imagined from there, with commands that are in time
    answered = model.answered(x)
    np.testing.assert_array_equal(answered[:N_IDENTIFIED], snapshot.x)
    plain = model_that_believes(0.10, foretell=False)[0].snapshot()
    assert plain.delay == 10
    ahead, _ = foretell(plain.x, plain.dx, plain.commands, 10, LAG, plain.model, True, DT)
    np.testing.assert_allclose(answered[:N_IDENTIFIED], ahead, rtol=1e-6)
    assert np.abs(answered[: STATE.r + 1] - x[: STATE.r + 1]).max() > 1e-4


@pytest.mark.parametrize(("delay", "changes"), [(0.0, {}), (0.10, {"foretell": False})])
def test_commands_in_time_are_answered_as_ever(delay, changes):
    model, x = model_that_believes(delay, **changes)
    assert model.foretold == 0
    assert model.answered(x) is x


@pytest.mark.parametrize("scale", [1e4, 1e60])
def test_a_state_beyond_all_numbers_is_not_answered(scale):
    """In 15 samples the first leaves float32, the second float64."""
    model, x = model_that_believes(0.15)
    model.rls.Theta *= scale
    with np.errstate(all="ignore"):
        snapshot, answered = model.snapshot(), model.answered(x)
    assert snapshot.delay == 15
    assert np.isfinite(snapshot.x).all()
    assert np.isfinite(answered).all()


def test_across_a_gap_nothing_is_foretold():
    model, x = model_that_believes(0.15)
    model.restart_history()
    assert model.foretold == 0
    model.observe(x)
    assert model.answered(x) is x


@pytest.mark.parametrize(("missed", "known"), [(0, True), (30, True), (50, True), (51, False), (None, False)])
def test_through_a_short_gap_the_last_command_is_taken_to_have_been_held(missed, known):
    """Half a second, as long as the last gate holds it: late commands that act after the gap are known all the same."""
    model, x = model_that_believes(0.15)
    last = model.snapshot().commands[-1]
    model.restart_history(missed=missed)
    for k in range(2):
        model.observe(x + k * 1e-6)
        model.command(np.zeros(N_ACTION))
    commands = model.snapshot().commands
    np.testing.assert_array_equal(commands[-2:], 0.0)
    if known:
        assert model.effectiveness.known
        held = min(missed, len(commands) - 2)
        np.testing.assert_array_equal(commands[len(commands) - 2 - held : -2], np.tile(last, (held, 1)))
    else:
        np.testing.assert_array_equal(commands, 0.0)


@pytest.mark.parametrize(
    ("coasted", "missed", "gone"), [(0, 30, 30), (4, 0, 4), (4, 6, 10), (5, 6, None), (11, 0, None)]
)
def test_other_filters_go_on_through_short_stretches_that_the_model_bridged(monkeypatch, coasted, missed, gone):
    model, _ = model_that_believes(0.05)
    for _ in range(coasted):
        model.command(np.zeros(N_ACTION))
        assert model.coast() is not None
    assert model.coasting == coasted
    told = []
    monkeypatch.setattr(model.state_filter, "restart", told.append)
    model.restart_history(missed)
    assert told == [gone]
    assert model.coasting == 0
