"""numpy = torch = ONNX: the increment of the model, whole rollouts, and what the graph is made of."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
import torch

from export.imagination import imagination
from export.loop import FREE_LOOP, LIMITED_LOOP, bodies
from export.network import Layer, Network, forward, n_parameters, unflatten
from export.rollout import MAX_DELAY
from task.limits import ACTION_HIGH, ACTION_LOW
from task.model import predict_increment
from task.observation import observation
from task.reward import CRASH_COST_PER_FRAME
from tests.export.transcription import NETWORKS, RETURN_TOLERANCE, STATE_TOLERANCE, Case, session


@pytest.mark.parametrize("exact", [True, False], ids=["exact-kinematics", "full-model"])
@pytest.mark.parametrize("lag", [0, 1, 3])
def test_increment(exact, lag, make_actors, nominal_model, full_model):
    """The states that the graph flies through are those of task.model, step by step."""
    network = NETWORKS["scaled"]
    population = make_actors(network, members=2)
    case = Case(20, lag, nominal_model if exact else full_model, exact)
    graph = imagination(network, population.parameters, lag)
    for name in ("after", "altitude"):
        graph.graph.output.append(onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None))
    states, altitude = session(graph).run(["after", "altitude"], case.feeds(population.parameters[1]))
    assert states.shape == (20, 1, 10, 3)

    tensors = unflatten(network, population.parameters.astype(float))
    x, dx = np.tile(case.x, (2, 1)), np.tile(case.dx, (2, 1))
    sent = [np.tile(c, (2, 1)) for c in case.commands[MAX_DELAY:]]
    angles_and_rates = [0, 1, 2, 4, 5, 6, 7] if exact else [0, 1, 2, 4, 5, 6, 7, 8]  # exact: heading is not flown
    for t in range(20):
        sent.append(forward(network, tensors, observation(x, case.reference[t])).clip(ACTION_LOW, ACTION_HIGH))
        dx = predict_increment(x, dx, sent[1] - sent[0], case.model, exact)
        sent.pop(0)
        x = x + dx
        flown = states[t, 0, :, :2].T
        np.testing.assert_allclose(flown[:, angles_and_rates], x[:, angles_and_rates], rtol=0, atol=2e-6)
        np.testing.assert_allclose(flown[:, 3], x[:, 3], rtol=0, atol=STATE_TOLERANCE * (1 + t / 5))
        np.testing.assert_allclose(altitude[t, 0, 0, :2], x[:, 9], rtol=0, atol=STATE_TOLERANCE * (1 + t / 5))
    np.testing.assert_allclose(states[..., 2], states[..., 1], rtol=1e-6, atol=1e-6)  # the incumbent is the second


@pytest.mark.parametrize("horizon", RETURN_TOLERANCE)
@pytest.mark.parametrize("exact", [True, False], ids=["exact-kinematics", "full-model"])
@pytest.mark.parametrize("name", ["thesis", "thesis-standard", "leaky", "scaled", "linear-law", "normalised-output"])
def test_rollout(name, exact, horizon, make_actors, nominal_model, full_model):
    network = NETWORKS[name]
    population = make_actors(network, members=3, seed=5)
    case = Case(horizon, 1, nominal_model if exact else full_model, exact)
    actors = np.concatenate([population.parameters, population.parameters[:1]])
    reference = case.by_numpy(network, actors)
    assert np.ptp(reference[:3]) > 50 * RETURN_TOLERANCE[horizon] or horizon == 1  # the members do differ
    graph = session(imagination(network, population.parameters, 1))
    (by_onnx,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
    np.testing.assert_allclose(by_onnx, reference, rtol=0, atol=RETURN_TOLERANCE[horizon])
    np.testing.assert_allclose(
        case.by_numpy(network, actors, np.float32), reference, rtol=0, atol=RETURN_TOLERANCE[horizon]
    )
    if horizon <= 200 and name in ("thesis", "leaky"):
        with torch.no_grad():
            by_torch = [case.by_torch(network, p) for p in actors[:3]]
        np.testing.assert_allclose(by_torch, reference[:3], rtol=0, atol=1e-9)


@pytest.mark.parametrize("lag", [0, 2, 5])
def test_rollout_at_other_command_lags(lag, make_actors, nominal_model):
    network = NETWORKS["scaled"]
    population = make_actors(network, members=3, seed=5)
    case = Case(50, lag, nominal_model, True)
    (by_onnx,) = session(imagination(network, population.parameters, lag)).run(
        ["returns"], case.feeds(population.parameters[2])
    )[0]
    actors = np.concatenate([population.parameters, population.parameters[2:]])
    np.testing.assert_allclose(by_onnx, case.by_numpy(network, actors), rtol=0, atol=RETURN_TOLERANCE[50])


@pytest.mark.parametrize("lag", [0, 1])
@pytest.mark.parametrize("delay", [0, 1, 5, 10, MAX_DELAY])
def test_rollout_with_delayed_commands(delay, lag, make_actors, nominal_model):
    """Numpy, torch and the graph agree, and a delay does matter."""
    network = NETWORKS["thesis"]
    population = make_actors(network, members=3, seed=5)
    case = Case(50, lag, nominal_model, True, delay)
    actors = np.concatenate([population.parameters, population.parameters[:1]])
    (by_onnx,) = session(imagination(network, population.parameters, lag)).run(
        ["returns"], case.feeds(population.parameters[0])
    )[0]
    reference = case.by_numpy(network, actors)
    np.testing.assert_allclose(by_onnx, reference, rtol=0, atol=RETURN_TOLERANCE[50])
    with torch.no_grad():
        np.testing.assert_allclose([case.by_torch(network, p) for p in actors[:3]], reference[:3], rtol=0, atol=1e-9)
    prompt = Case(50, lag, nominal_model, True).by_numpy(network, actors)
    assert delay == 0 or np.abs(prompt - reference).max() > 50 * RETURN_TOLERANCE[50]


def test_a_delay_is_what_a_longer_command_lag_would_be(make_actors, nominal_model):
    network = NETWORKS["scaled"]
    population = make_actors(network, members=2)
    delayed = Case(50, 1, nominal_model, True, delay=4)
    lagging = Case(50, 5, nominal_model, True)
    lagging.commands[:] = 0.0
    lagging.commands[-6:] = delayed.commands[-6:]
    returns = [
        session(imagination(network, population.parameters, lag)).run(["returns"], case.feeds(population.parameters[0]))
        for lag, case in ((1, delayed), (5, lagging))
    ]
    np.testing.assert_array_equal(returns[0], returns[1])


def test_several_models_are_several_imaginations(make_actors, nominal_model):
    network = NETWORKS["thesis-standard"]
    population = make_actors(network, members=3, seed=5)
    graph = session(imagination(network, population.parameters, 1))
    models = np.stack([nominal_model * scale for scale in (1.0, 0.98, 1.01)])
    models[1, 10:] *= -1.0
    together = graph.run(["returns"], Case(100, 1, models, True, delay=3).feeds(population.parameters[0]))[0]
    assert together.shape == (3, 4)
    for model, returns in zip(models, together, strict=True):
        case = Case(100, 1, model, True, delay=3)
        (alone,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
        np.testing.assert_allclose(returns, alone, rtol=0, atol=RETURN_TOLERANCE[200])
    assert np.ptp(together[:, 0]) > 1.0


def test_unsafe_samples_are_counted_until_the_flight_is_lost(make_actors, nominal_model):
    """Eq. 14: from one flight that banks steeply on, to one that is lost."""
    network = NETWORKS["linear-law"]
    population = make_actors(network, members=4, gain=3.0)
    case = Case(300, 1, nominal_model, True)
    case.x[4], case.x[6] = 0.19, 1.02
    actors = np.concatenate([population.parameters, population.parameters[:1]])
    (returns,), (unsafe,) = session(imagination(network, population.parameters, 1)).run(
        ["returns", "unsafe"], case.feeds(population.parameters[0])
    )
    expected = case.imagined(network, actors)
    np.testing.assert_allclose(unsafe, expected.unsafe, rtol=0, atol=1.0)  # the crossing may fall one sample apart
    np.testing.assert_allclose(returns, expected.returns, rtol=0, atol=2.0)
    assert np.ptp(unsafe) > 10.0


@pytest.mark.parametrize("lag", [0, 1, 3])
@pytest.mark.parametrize("delay", [0, 5])
def test_surface_travel_is_that_of_the_commands_that_act(delay, lag, make_actors, nominal_model):
    network = NETWORKS["thesis"]
    population = make_actors(network, members=3, seed=5)
    case = Case(100, lag, nominal_model, True, delay)
    actors = np.concatenate([population.parameters, population.parameters[:1]])
    (travel,) = session(imagination(network, population.parameters, lag)).run(
        ["travel"], case.feeds(population.parameters[0])
    )[0]
    np.testing.assert_allclose(travel, case.imagined(network, actors).travel, rtol=1e-3, atol=1e-5)
    assert np.ptp(travel[:3]) > 0.01


def test_surface_travel_by_hand(make_actors, nominal_model):
    """Members that command zero whatever they see: what is left is the way there from the commands sent before."""
    network = NETWORKS["linear-law"]
    actors = np.zeros_like(make_actors(network, members=2).parameters)
    case = Case(50, 1, nominal_model, True)
    acted, acting = np.array([0.01, -0.02, 0.03]), np.array([-0.01, 0.0, 0.05])
    case.commands[-2:] = acted, acting
    expected = np.abs(acting - acted).sum() + np.abs(acting).sum()
    (travel,) = session(imagination(network, actors, 1)).run(["travel"], case.feeds(actors[0]))[0]
    np.testing.assert_allclose(travel, expected, rtol=1e-5)
    np.testing.assert_allclose(case.imagined(network, actors).travel, expected, rtol=1e-9)


def test_surface_travel_counts_until_the_flight_is_lost(make_actors, nominal_model):
    network = NETWORKS["linear-law"]
    population = make_actors(network, members=4, gain=3.0)
    case = Case(300, 1, 1.5 * nominal_model, True)
    returns, travel = session(imagination(network, population.parameters, 1)).run(
        ["returns", "travel"], case.feeds(population.parameters[0])
    )
    expected = case.imagined(network, np.concatenate([population.parameters, population.parameters[:1]]))
    assert (returns < -100.0).all()
    assert np.isfinite(travel).all()
    np.testing.assert_allclose(travel[0], expected.travel, rtol=0.05)


@pytest.mark.parametrize("exact", [True, False])
def test_returns_stay_finite_when_the_model_diverges(exact, make_actors, nominal_model, full_model):
    network = NETWORKS["thesis"]
    population = make_actors(network, members=3)
    case = Case(400, 1, 1.5 * (nominal_model if exact else full_model), exact)
    (returns,) = session(imagination(network, population.parameters, 1)).run(
        ["returns"], case.feeds(population.parameters[0])
    )[0]
    assert np.isfinite(returns).all()
    assert (returns < -0.5 * 400 * CRASH_COST_PER_FRAME).all()
    expected = case.by_numpy(network, np.concatenate([population.parameters, population.parameters[:1]]))
    np.testing.assert_allclose(returns, expected, rtol=0, atol=2.0)  # the crossing may fall one step apart


@pytest.mark.parametrize("poison", ["x", "model", "commands"])
def test_nan_inputs_cost_a_crash_from_the_start(poison, make_actors, nominal_model):
    network = NETWORKS["scaled"]
    population = make_actors(network, members=2)
    feeds = Case(10, 1, nominal_model, True).feeds(population.parameters[0])
    feeds[poison] = np.full_like(feeds[poison], np.nan)
    (returns,) = session(imagination(network, population.parameters, 1)).run(["returns"], feeds)[0]
    np.testing.assert_array_equal(returns, -10 * CRASH_COST_PER_FRAME)


def test_a_poisoned_incumbent_leaves_the_members_alone(make_actors, nominal_model):
    network = NETWORKS["thesis"]
    population = make_actors(network, members=3)
    graph = session(imagination(network, population.parameters, 1))
    case = Case(50, 1, nominal_model, True)
    (sound,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
    (returns,) = graph.run(["returns"], case.feeds(np.full_like(population.parameters[0], np.nan)))[0]
    np.testing.assert_array_equal(returns[:-1], sound[:-1])
    assert returns[-1] == -50 * CRASH_COST_PER_FRAME


def test_the_imagination_limits_commands_as_the_gate_does(make_actors, nominal_model):
    network = Network(layers=(Layer(units=3, activation="linear"),), action_scale=(5.0, 5.0, 5.0))
    population = make_actors(network, members=3, gain=3.0)
    case = Case(50, 1, nominal_model, True)
    (returns,) = session(imagination(network, population.parameters, 1)).run(
        ["returns"], case.feeds(population.parameters[0])
    )[0]
    expected = case.by_numpy(network, np.concatenate([population.parameters, population.parameters[:1]]))
    np.testing.assert_allclose(returns, expected, rtol=0, atol=1e-3)


def test_the_loop_holds_few_nodes(make_actors):
    """A node costs about a microsecond a step; whoever adds one should know it."""
    nodes = {}
    for name in ("thesis", "thesis-standard", "td3-relu"):
        loops = bodies(imagination(NETWORKS[name], make_actors(NETWORKS[name]).parameters, 1))
        for body in loops.values():
            assert not any(n.op_type in ("Loop", "If", "Scan") for n in body.node)
        nodes[name] = len(loops[FREE_LOOP].node)
        assert len(loops[LIMITED_LOOP].node) == nodes[name] + 4
    assert nodes["td3-relu"] <= 24
    assert nodes["thesis"] <= 42
    assert nodes["thesis-standard"] <= 36


def test_members_weights_are_stored_once(make_actors):
    network = NETWORKS["thesis"]
    model = imagination(network, make_actors(network, members=8).parameters, 1)
    assert len(model.SerializeToString()) < 1.2 * 4 * 8 * n_parameters(network) + 50_000
