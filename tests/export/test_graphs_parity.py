"""numpy = torch = ONNX: one step of a policy, the increment of the model, whole rollouts.

torch stands here as an independent transcription, in float64: modules as anybody would write them.
"""

from __future__ import annotations

import itertools

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from export.behaviour import behaviour
from export.imagination import imagination
from export.loop import FREE_LOOP, LIMITED_LOOP, bodies
from export.network import Layer, Network, forward, n_parameters, unflatten
from export.population import Description, Member, Population
from export.rollout import MAX_DELAY, Imagined, rollout
from task.actuators import ACTUATOR, HEALTHY, limited
from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.model import embed_reduced, predict_increment, with_effectiveness
from task.observation import observation
from task.reference import random_reference
from task.reward import CRASH_COST_PER_FRAME, REWARD_SCALE
from task.state import ACTION, N_IDENTIFIED

ACTION_TOLERANCE = 2e-6
"""One step of a policy in float32 [rad]."""
STATE_TOLERANCE = 3e-4
"""One step of the model in float32: the spacing of float32 at 2000 m is 1.2e-4 [m]; angles and rates are below 1e-6."""
RETURN_TOLERANCE = {1: 1e-6, 50: 2e-5, 200: 2e-4, 400: 1e-3}
"""Return over a horizon [steps] in float32; returns are about -0.1 to -1 a step."""


def hidden(width: int, *norms: str, activation: str = "tanh") -> tuple[Layer, ...]:
    return tuple(Layer(units=width, layer_norm=norm, activation=activation) for norm in norms)


NETWORKS = {
    "thesis": Network(layers=(*hidden(32, "none", *["unbiased"] * 3), Layer(units=3)), layer_norm_eps=1e-6),
    "thesis-standard": Network(layers=(*hidden(24, "none", *["standard"] * 3), Layer(units=3))),
    "td3-relu": Network(layers=(*hidden(48, "none", "none", "none", activation="relu"), Layer(units=3))),
    "leaky": Network(layers=(*hidden(16, "standard", "unbiased", activation="leaky_relu"), Layer(units=3))),
    "scaled": Network(
        layers=(*hidden(8, "none"), Layer(units=3)),
        input_scale=(3.0, 2.0, 5.0, 0.5, 0.5, 0.5, 1.0),
        action_scale=(0.1, 0.05, -0.08),
        action_offset=(-0.025, 0.0, 0.01),
    ),
    "linear-law": Network(layers=(Layer(units=3, activation="linear"),), action_scale=(0.3, 0.3, 0.3)),
    "normalised-output": Network(layers=(*hidden(8, "none"), Layer(units=3, layer_norm="unbiased"))),
    "normalised-output-standard": Network(layers=(*hidden(8, "none"), Layer(units=3, layer_norm="standard"))),
}


class UnbiasedLayerNorm(nn.Module):
    """LayerNorm of the published code: unbiased standard deviation, eps added to it."""

    def __init__(self, units: int, eps: float) -> None:
        super().__init__()
        self.weight, self.bias = nn.Parameter(torch.ones(units)), nn.Parameter(torch.zeros(units))
        self.eps = eps

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        mean, std = x.mean(-1, keepdim=True), x.std(-1, keepdim=True)
        return self.weight * (x - mean) / (std + self.eps) + self.bias


class TorchActor(nn.Module):
    """One actor of a network, as plain modules in float64."""

    def __init__(self, network: Network, parameters: np.ndarray) -> None:
        super().__init__()
        self.network = network
        tensors = {k: torch.tensor(v, dtype=torch.float64) for k, v in unflatten(network, parameters).items()}
        modules: list[nn.Module] = []
        inputs = network.observation
        for i, layer in enumerate(network.layers):
            linear = nn.Linear(inputs, layer.units)
            linear.weight, linear.bias = (nn.Parameter(tensors[f"layers.{i}.{k}"]) for k in ("weight", "bias"))
            modules.append(linear)
            if layer.layer_norm != "none":
                unbiased = layer.layer_norm == "unbiased"
                norm = (UnbiasedLayerNorm if unbiased else nn.LayerNorm)(layer.units, eps=network.layer_norm_eps)
                norm.weight, norm.bias = (nn.Parameter(tensors[f"layers.{i}.{k}"]) for k in ("gain", "shift"))
                modules.append(norm)
            modules.append(
                {
                    "tanh": nn.Tanh(),
                    "relu": nn.ReLU(),
                    "leaky_relu": nn.LeakyReLU(network.leaky_slope),
                    "linear": nn.Identity(),
                }[layer.activation]
            )
            inputs = layer.units
        self.net = nn.Sequential(*modules)

    def forward(self, s: torch.Tensor) -> torch.Tensor:
        n = self.network
        scales = (torch.tensor(v, dtype=torch.float64) for v in (n.input_scale, n.action_scale, n.action_offset))
        input_scale, action_scale, action_offset = scales
        return action_offset + action_scale * self.net(input_scale * s)


def session(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(model.SerializeToString(), options)


def assert_one_step_agrees(population: Population, observations: np.ndarray) -> None:
    network = population.network
    graph = session(behaviour(network))
    reference = np.stack([
        forward(network, unflatten(network, population.parameters.astype(float)), s) for s in observations
    ])  # fmt: skip
    for member, parameters in enumerate(population.parameters):
        with torch.no_grad():
            by_torch = TorchActor(network, parameters)(torch.tensor(observations)).numpy()
        np.testing.assert_allclose(by_torch, reference[:, member], rtol=0, atol=1e-12)
        tensors = unflatten(network, parameters)
        for s, expected in zip(observations.astype(np.float32), reference[:, member], strict=True):
            (action,) = graph.run(["action"], {"observation": s[None], **tensors})
            np.testing.assert_allclose(action[0], expected, rtol=0, atol=ACTION_TOLERANCE)
            by_numpy = forward(network, {k: v[None] for k, v in tensors.items()}, s[None])
            assert by_numpy.dtype == np.float32
            np.testing.assert_allclose(by_numpy[0], expected, rtol=0, atol=ACTION_TOLERANCE)


@pytest.mark.parametrize("name", NETWORKS)
def test_policy_step(name, make_actors):
    observations = np.random.default_rng(1).uniform(-0.4, 0.4, (6, 7)).astype(np.float32).astype(float)
    assert_one_step_agrees(make_actors(NETWORKS[name], members=3), observations)


@st.composite
def networks(draw: st.DrawFn) -> Network:
    count = draw(st.integers(0, 4))
    layers = [
        # narrower normalised layers are all but sign functions: there float32 itself is not smooth
        Layer(
            units=draw(st.integers(8, 40)),
            layer_norm=draw(st.sampled_from(["none", "standard", "unbiased"])),
            activation=draw(st.sampled_from(["tanh", "relu", "leaky_relu", "linear"])),
        )
        for _ in range(count)
    ]
    scales = st.floats(0.1, 3.0)
    return Network(
        layers=(*layers, Layer(units=3)),
        input_scale=tuple(draw(scales) for _ in range(7)),
        leaky_slope=draw(st.floats(0.0, 0.5)),
        layer_norm_eps=draw(st.sampled_from([1e-6, 1e-5, 1e-3])),
        action_offset=tuple(draw(st.floats(-0.05, 0.05)) for _ in range(3)),
    )


@settings(max_examples=25, deadline=None, derandomize=True)
@given(network=networks(), seed=st.integers(0, 2**16))
def test_policy_step_of_any_network(network, seed):
    rng = np.random.default_rng(seed)
    tensors = 0.5 * rng.normal(size=(2, n_parameters(network))).astype(np.float32)
    description = Description(network=network, members=(Member(name="a"), Member(name="b")), champion="a")
    observations = rng.uniform(-0.4, 0.4, (2, 7)).astype(np.float32).astype(float)
    assert_one_step_agrees(Population(description, tensors), observations)


# ---------------------------------------------------------------------------------------------------- the model


class Case:
    """One imagination's inputs, in float64 values that float32 holds exactly."""

    def __init__(
        self, horizon: int, lag: int, model: np.ndarray, exact: bool, delay: int = 0, seed: int = 3,
        actuators: np.ndarray = HEALTHY,
    ) -> None:  # fmt: skip
        self.delay, self.actuators = delay, self._exact(actuators)
        rng = np.random.default_rng(seed)
        x = np.zeros(10)
        x[:3] = rng.normal(0.0, 0.01, 3)
        x[3:10] = 90.0, 0.06, 0.01, 0.1, 0.06, 0.5, 2000.0
        reference = random_reference(rng, 20.0, 0.06)[: horizon + 1]
        self.x, self.dx = self._exact(x), self._exact(1e-4 * rng.normal(size=10))
        self.commands = self._exact(rng.uniform(-0.02, 0.02, (lag + 1 + MAX_DELAY, 3)))
        self.model, self.reference, self.exact = self._exact(model), self._exact(reference), exact

    @staticmethod
    def _exact(array: np.ndarray) -> np.ndarray:
        return array.astype(np.float32).astype(float)

    def imagined(self, network: Network, parameters: np.ndarray, kind: type = np.float64) -> Imagined:
        x, dx, commands, model = (a.astype(kind) for a in (self.x, self.dx, self.commands, self.model))
        reference = self.reference.astype(kind)
        return rollout(network, parameters, x, dx, commands, self.delay, model, self.exact, reference, self.actuators)

    def by_numpy(self, network: Network, parameters: np.ndarray, kind: type = np.float64) -> np.ndarray:
        return self.imagined(network, parameters, kind).returns

    def feeds(self, incumbent: np.ndarray) -> dict[str, np.ndarray]:
        feeds = {k: getattr(self, k).astype(np.float32) for k in ("x", "dx", "commands", "reference", "actuators")}
        return {
            **feeds,
            "delay": np.array(self.delay),
            "model": np.atleast_3d(self.model.T).T.astype(np.float32),
            "exact_kinematics": np.array(self.exact),
            "incumbent": incumbent,
        }

    def by_torch(self, network: Network, parameters: np.ndarray) -> float:
        """One member's return, one number at a time, straight from the equations."""
        actor = TorchActor(network, parameters)
        low, high = torch.tensor(ACTION_LOW), torch.tensor(ACTION_HIGH)
        x, dx = torch.tensor(self.x), torch.tensor(self.dx)
        theta = torch.tensor(self.model)
        sent = [torch.tensor(c) for c in self.commands[MAX_DELAY - self.delay :]]
        total, alive = 0.0, True
        for now, following in zip(self.reference[:-1], self.reference[1:], strict=True):
            p, q, r, V, alpha, beta, phi, pitch, *_ = x
            errors = torch.stack([now[0] - pitch, now[1] - phi, now[2] - beta])
            sent.append(torch.clamp(actor(torch.cat([errors, torch.stack([p, q, r, alpha])])), low, high))
            dx = theta.T @ torch.cat([dx, sent[1] - sent[0]])
            sent.pop(0)
            if self.exact:
                p, q, r, V, alpha, beta = (x + 0.5 * dx)[:6]
                sin, cos = torch.sin, torch.cos
                turn = (q * sin(phi) + r * cos(phi)) / cos(pitch)
                climb = V * (
                    cos(alpha) * cos(beta) * sin(pitch)
                    - sin(beta) * sin(phi) * cos(pitch)
                    - sin(alpha) * cos(beta) * cos(phi) * cos(pitch)
                )
                rates = torch.stack([p + turn * sin(pitch), q * cos(phi) - r * sin(phi), turn, climb])
                dx = torch.cat([dx[:6], DT * rates])
            x = x + dx
            alive = alive and bool(x[7].abs() <= np.deg2rad(60) and x[6].abs() <= np.deg2rad(75) and x[9] >= 50)
            error = torch.tensor(following) - x[[7, 6, 5]]
            reward = -(torch.tensor(REWARD_SCALE) * error).clamp(-1, 1).abs().sum() / 3
            total += float(reward) if alive else -CRASH_COST_PER_FRAME
        return total


@pytest.fixture(scope="module")
def nominal_model(short_prior) -> np.ndarray:
    return embed_reduced(short_prior.theta)


@pytest.fixture(scope="module")
def full_model(nominal_model) -> np.ndarray:
    """A model of all ten states whose attitude follows the rates, as least squares would find it."""
    model = nominal_model.copy()
    model[:3, 6:9] = DT * np.eye(3)
    model[6:9, 6:9] = 0.02 * np.eye(3)
    model[3:5, 9] = 0.01, -0.3
    return model


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


# ------------------------------------------------------------------------------------------------ limited actuators


@pytest.mark.parametrize(
    ("name", "lag", "delay"), [*itertools.product(["thesis", "scaled"], [0, 1], [0, 15]), ("linear-law", 3, 1)]
)
def test_limited_actuators(delay, lag, name, make_actors, nominal_model, tight):
    """In several models, one with crossed surfaces; each surface's limits are felt."""
    network = NETWORKS[name]
    population = make_actors(network, members=3, seed=5)
    graph = session(imagination(network, population.parameters, lag))
    crossed = with_effectiveness(nominal_model, np.array([[0.3, -0.5, 0.0], [0.4, 1.0, 0.2], [0.0, 0.1, -1.0]]))
    models = np.stack([nominal_model, crossed, nominal_model * 0.99])
    actors = np.concatenate([population.parameters, population.parameters[:1]])

    def flown(actuators: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        case = Case(100, lag, models, True, delay, actuators=actuators)
        expected = []
        for model in models:
            alone = Case(100, lag, model, True, delay, actuators=actuators)
            expected.append(alone.by_numpy(network, actors))
        return np.stack(expected), graph.run(["returns"], case.feeds(population.parameters[0]))[0]

    healthy, _ = flown(HEALTHY)
    expected, returns = flown(tight())
    np.testing.assert_allclose(returns, expected, rtol=0, atol=RETURN_TOLERANCE[200])
    for surface in ACTION:
        actuators = tight()
        actuators[:, surface] = HEALTHY[:, surface]
        less, returns = flown(actuators)
        np.testing.assert_allclose(returns, less, rtol=0, atol=RETURN_TOLERANCE[200])
        assert np.abs(less - expected).max() > 10 * RETURN_TOLERANCE[200]
    assert np.abs(healthy - expected).max() > 100 * RETURN_TOLERANCE[200]


@pytest.mark.parametrize("lag", [0, 1])
@pytest.mark.parametrize("delay", [0, 1, 15])
def test_healthy_actuators_are_those_that_no_limit_holds(delay, lag, make_actors, nominal_model):
    """Both loops fly alike where limits are beyond what is commanded, and so does the reference.

    Products of more rows may add up in another order.
    """
    network = NETWORKS["thesis"]
    population = make_actors(network, members=3, seed=5)
    graph = session(imagination(network, population.parameters, lag))
    wide = HEALTHY.copy()
    wide[ACTUATOR.rate] = 100.0
    answers, references = [], []
    for actuators in (HEALTHY, wide):
        case = Case(200, lag, nominal_model, True, delay, actuators=actuators)
        answers.append(graph.run(["returns", "unsafe"], case.feeds(population.parameters[0])))
        references.append(case.by_numpy(network, population.parameters))
    np.testing.assert_allclose(answers[1], answers[0], rtol=0, atol=RETURN_TOLERANCE[200])
    np.testing.assert_array_equal(references[0], references[1])


@pytest.mark.parametrize("lag", [0, 1, 3])
@pytest.mark.parametrize("delay", [0, 1, 15])
def test_what_acts_already_is_given_and_what_waits_is_limited(delay, lag, make_actors, nominal_model, tight):
    """Commands sent before lie beyond the range, and further apart than the rate."""
    network = NETWORKS["scaled"]
    population = make_actors(network, members=2)
    graph = session(imagination(network, population.parameters, lag))
    actuators = tight(rate=0.5)
    case = Case(40, lag, nominal_model, True, delay, actuators=actuators)
    case.commands[:] = np.random.default_rng(8).uniform(-0.1, 0.1, case.commands.shape).astype(np.float32)

    def flown(case: Case) -> np.ndarray:
        expected = case.by_numpy(network, population.parameters)
        returns = graph.run(["returns"], case.feeds(population.parameters[0]))[0][0, :2]
        np.testing.assert_allclose(returns, expected, rtol=0, atol=RETURN_TOLERANCE[50])
        return expected

    as_given, first = flown(case), MAX_DELAY - case.delay
    queue = case.commands[first:]
    acting = [*queue[:2]]
    for command in queue[2:]:
        acting.append(limited(command, acting[-1], actuators))
    queue[:] = acting
    np.testing.assert_allclose(flown(case), as_given, rtol=0, atol=1e-6)  # limits know what has been limited
    queue[0] = limited(queue[0], np.zeros(3), actuators)
    assert np.abs(flown(case) - as_given).max() > 10 * RETURN_TOLERANCE[50]


def test_a_jammed_surface_flies_as_a_command_that_stays(make_actors, nominal_model):
    """An elevator that is stuck is one that the model does not feel, once it stands where it stuck."""
    network = NETWORKS["thesis"]
    population = make_actors(network, members=3, seed=5)
    case = Case(100, 1, nominal_model, True)
    case.commands[:, ACTION.de] = -0.015625
    case.actuators = HEALTHY.copy()
    case.actuators[: ACTUATOR.rate, ACTION.de] = -0.015625
    graph = session(imagination(network, population.parameters, 1))
    (jammed,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
    case.actuators = HEALTHY
    (free,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
    case.model = nominal_model.copy()
    case.model[N_IDENTIFIED + ACTION.de] = 0.0
    (dead,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
    np.testing.assert_allclose(jammed, dead, rtol=0, atol=RETURN_TOLERANCE[200])
    assert np.abs(jammed - free).max() > 1.0


def test_nan_among_the_limits_costs_a_crash(make_actors, nominal_model):
    network = NETWORKS["thesis"]
    population = make_actors(network, members=2)
    graph = session(imagination(network, population.parameters, 1))
    for row in ACTUATOR:
        actuators = HEALTHY.copy()
        actuators[row, ACTION.de] = np.nan
        case = Case(20, 1, nominal_model, True, actuators=actuators)
        (returns,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
        assert (returns <= -(20 - 1) * CRASH_COST_PER_FRAME).all()  # the first command acts one sample late


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
