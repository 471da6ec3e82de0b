"""The rate model fitted on the plant, and members with reversed commands."""

from pathlib import Path

import numpy as np
import pytest

from export.folder import RATES, write_population
from export.mirrors import AXES, mirror_name, with_mirrors
from export.network import Layer, Network, forward, unflatten
from export.prior import PriorSettings, excited_flight
from export.rates import RateSettings, rate_model, regression
from runtime.population import load_population
from sim_bridge.conditions import NOMINAL
from sim_bridge.plant import Plant
from task.errors import UserError
from task.rates import (
    HIGH_ALPHA,
    LOW_ALPHA,
    N_FEATURES,
    RATE_MODEL_VERSION,
    RateModel,
    dynamic_pressure,
    effect_terms,
    features,
)
from task.state import ACTION, N_IDENTIFIED, STATE

POPULATIONS = Path(__file__).resolve().parents[2] / "populations"
TANH = Network(layers=(Layer(units=12), Layer(units=12, layer_norm="standard"), Layer(units=3)))


@pytest.fixture(scope="module")
def rates():
    return rate_model(RateSettings(conditions=(NOMINAL,), duration=30.0))


def test_the_rate_model_predicts_a_flight_that_it_has_not_seen(rates):
    rng = np.random.default_rng(77)
    states, commands = excited_flight(Plant(), rng, NOMINAL, PriorSettings(duration=20.0))
    z, y = regression(states[:, :N_IDENTIFIED], commands)
    theta = np.concatenate([rates.drift, rates.effect.reshape(-1, 3)])
    assert theta.shape[0] == z.shape[1]
    error = y - z @ theta
    # The pitching moment has a slow part that is the engines'; between samples it is known as well as the others.
    assert (np.diff(error, axis=0).std(axis=0) < 0.2 * np.diff(y, axis=0).std(axis=0)).all()
    assert (error.std(axis=0)[[STATE.p, STATE.r]] < 0.1 * y.std(axis=0)[[STATE.p, STATE.r]]).all()


def test_each_surface_turns_the_aircraft_as_the_table_of_signs_says(rates):
    qbar = dynamic_pressure(90.0, 2000.0)
    effect = np.einsum("t,jta->ja", np.array(effect_terms(90.0, 0.06, qbar)), rates.effect)
    assert effect[ACTION.de, STATE.q] < -10.0
    assert effect[ACTION.da, STATE.p] < -5.0
    assert effect[ACTION.dr, STATE.r] < -1.5


def test_beyond_the_angles_that_the_fit_has_seen_the_model_stays_as_it_is():
    qbar = dynamic_pressure(90.0, 2000.0)
    for inside, outside in ((HIGH_ALPHA, 0.7), (LOW_ALPHA, -0.7)):
        assert effect_terms(90.0, outside, qbar) == pytest.approx(effect_terms(90.0, inside, qbar))
        ends = [features(0.1, -0.2, 0.3, 90.0, alpha, 0.05, 0.1, qbar) for alpha in (inside, outside)]
        assert ends[0] == pytest.approx(ends[1])
    # What is fitted half a degree inside must not decide what a deep stall is like: no surface works backwards there.
    shipped = load_population(POPULATIONS / "citation").rates
    for alpha in np.linspace(-1.0, 1.0, 41):
        effect = np.einsum("t,jta->ja", np.array(effect_terms(90.0, alpha, qbar)), shipped.effect)
        assert effect[ACTION.de, STATE.q] < -5.0
        assert effect[ACTION.da, STATE.p] < -5.0
        assert effect[ACTION.dr, STATE.r] < -1.5


def test_the_rate_model_travels_with_the_population(rates, make_actors, short_prior, tmp_path):
    population = make_actors(TANH)
    write_population(population, short_prior, tmp_path / "with", rates=rates)
    loaded = load_population(tmp_path / "with").rates
    np.testing.assert_array_equal(loaded.drift, rates.drift)
    np.testing.assert_array_equal(loaded.effect, rates.effect)
    write_population(population, short_prior, tmp_path / "without")
    assert load_population(tmp_path / "without").rates is None
    (tmp_path / "with" / RATES).write_bytes(b"changed")
    with pytest.raises(UserError, match=r"rate_model.npz: SHA-256 .* is not the manifest's"):
        load_population(tmp_path / "with")


def test_another_structure_is_refused_in_one_line(rates, make_actors, short_prior, tmp_path, monkeypatch):
    monkeypatch.setattr("export.folder.RATE_MODEL_VERSION", RATE_MODEL_VERSION + 1)
    write_population(make_actors(TANH), short_prior, tmp_path / "newer", rates=rates)
    with pytest.raises(UserError, match=r"rate_model.npz: version: this runtime reads 2, got 3"):
        load_population(tmp_path / "newer")
    monkeypatch.setattr("export.folder.RATE_MODEL_VERSION", RATE_MODEL_VERSION)
    wrong = RateModel(np.zeros((N_FEATURES + 1, 3)), rates.effect)
    write_population(make_actors(TANH), short_prior, tmp_path / "wrong", rates=wrong)
    with pytest.raises(UserError, match="expected finite"):
        load_population(tmp_path / "wrong")


@pytest.mark.parametrize(
    "last", [Layer(units=3), Layer(units=3, activation="linear"), Layer(units=3, layer_norm="unbiased")]
)
def test_a_mirror_commands_the_exact_opposite(make_actors, last):
    network = Network(layers=(Layer(units=12, activation="relu"), last))
    population = make_actors(network, members=3)
    mirrored = with_mirrors(population, "run")
    names = [m.name for m in mirrored.description.members]
    assert names[:3] == ["actor-0", "actor-1", "actor-2"]
    assert names[3:] == [f"actor-1/-{axes}" for axes in ("e", "a", "r", "ea", "er", "ar", "ear")]
    assert mirrored.description.champion == "actor-1"
    np.testing.assert_array_equal(mirrored.parameters[:3], population.parameters)
    tensors = unflatten(network, mirrored.parameters)
    for s in np.random.default_rng(0).uniform(-0.4, 0.4, (10, 7)).astype(np.float32):
        actions = forward(network, tensors, s)
        for member, axes in enumerate(AXES, start=3):
            sign = np.ones(3)
            sign[list(axes)] = -1.0
            np.testing.assert_array_equal(actions[member], sign * actions[1])


@pytest.mark.parametrize(
    "network",
    [
        Network(layers=(Layer(units=3),), action_offset=(-0.02, 0.0, 0.0)),
        Network(layers=(Layer(units=3, activation="relu"),)),
    ],
)
def test_a_mirror_that_would_not_be_exact_is_refused(make_actors, network):
    with pytest.raises(UserError, match="run: --mirrors: expected a last layer of tanh or linear and action_offset 0"):
        with_mirrors(make_actors(network), "run")


def test_mirrors_are_not_added_twice(make_actors):
    mirrored = with_mirrors(make_actors(TANH), "run")
    assert mirror_name("actor-1", (ACTION.de,)) == "actor-1/-e"
    with pytest.raises(UserError, match=r"has members actor-1/-a, .* already"):
        with_mirrors(mirrored, "run")
