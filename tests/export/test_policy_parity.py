"""numpy = torch = ONNX: one step of a policy, of the shapes that are shipped and of any."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from export.behaviour import behaviour
from export.network import Layer, Network, forward, n_parameters, unflatten
from export.population import Description, Member, Population
from tests.export.transcription import ACTION_TOLERANCE, NETWORKS, TorchActor, session


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
