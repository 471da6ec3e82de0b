"""Stacked networks against plain ones: forward, hand-derived backward, Adam, and the actors in flight."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn import functional

from export.network import Layer, Network, n_parameters, unflatten
from export.network import forward as reference_forward
from export.training.acting import Cast
from export.training.config import ActorSettings, TD3Settings
from export.training.networks import (
    Stack,
    Trainable,
    actor_network,
    critic_network,
    initialise,
    pack,
    pieces,
    unpack,
    views,
    weight_mask,
)

SCALE = (8.0, 8.0, 20.0, 4.0, 4.0, 4.0, 8.0)
ACTIVATE = {
    "tanh": torch.tanh,
    "relu": torch.relu,
    "leaky_relu": lambda z: functional.leaky_relu(z, 0.01),
    "linear": lambda z: z,
}


def plain(network: Network, tensors: list[torch.Tensor], member: int, x: torch.Tensor) -> torch.Tensor:
    """One member alone, layer by layer, for autograd."""
    parts = iter(tensors)
    h = x
    for layer in network.layers:
        h = functional.linear(h, next(parts)[member], next(parts)[member])
        if layer.layer_norm == "standard":
            h = functional.layer_norm(h, (layer.units,), next(parts)[member], next(parts)[member], 1e-5)
        h = ACTIVATE[layer.activation](h)
    return h


def shuffled(network: Network, count: int, seed: int = 0) -> torch.Tensor:
    """Parameters whose gains and shifts are not one and zero."""
    generator = torch.Generator().manual_seed(seed)
    parameters = initialise(network, count, generator)
    return parameters + 0.1 * torch.randn(parameters.shape, generator=generator)


NETWORKS = [
    actor_network(ActorSettings(width=9, hidden=2)),
    critic_network(actor_network(ActorSettings()), TD3Settings(critic_layers=(8, 5))),
    *(
        Network(layers=(Layer(units=6, layer_norm=norm, activation=activation), Layer(units=3, activation="linear")))
        for activation in ("tanh", "relu", "leaky_relu", "linear")
        for norm in ("none", "standard")
    ),
]


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("shared", [False, True])
def test_forward_and_backward_equal_autograd(network: Network, shared: bool) -> None:
    count, batch = 3, 7
    generator = torch.Generator().manual_seed(1)
    parameters = shuffled(network, count).double()
    x = torch.randn(
        (batch, network.observation) if shared else (count, batch, network.observation), generator=generator
    )
    x = x.double()
    stack = Trainable(network, parameters, 0.0)
    out = stack(x)
    upstream = torch.randn(out.shape, generator=generator).double()
    to_input = stack.backward(upstream, to_input=True)

    leaves = [v.clone().requires_grad_() for v in views(network, parameters)]
    inputs = (x.expand(count, *x.shape) if shared else x).clone().requires_grad_()
    expected = torch.stack([plain(network, leaves, i, inputs[i]) for i in range(count)])
    (expected * upstream).sum().backward()

    torch.testing.assert_close(out, expected.detach(), rtol=1e-10, atol=1e-12)
    for got, leaf in zip(pieces(network, stack.grad), leaves, strict=True):
        torch.testing.assert_close(got, leaf.grad, rtol=1e-8, atol=1e-10)
    torch.testing.assert_close(to_input, inputs.grad, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("network", NETWORKS)
def test_kernels_compute_what_the_tensor_operations_do(network: Network) -> None:
    generator = torch.Generator().manual_seed(5)
    parameters = shuffled(network, 3)
    x, upstream = torch.randn(3, 11, network.observation, generator=generator), None
    results = []
    for precision in (torch.float32, torch.float64):  # kernels serve single precision alone
        stack = Trainable(network, parameters.to(precision), 1e-3)
        out = stack(x.to(precision)).clone()
        upstream = torch.randn(out.shape, generator=generator) if upstream is None else upstream
        to_input = stack.backward(upstream.to(precision), to_input=True).clone()
        gradient = stack.grad.clone()
        for _ in range(3):
            stack.step(0.5)
        results.append([value.double() for value in (out, to_input, gradient, stack.packed)])
    for fast, exact in zip(*results, strict=True):
        torch.testing.assert_close(fast, exact, rtol=2e-4, atol=2e-5)


def test_gradient_is_the_difference_quotient() -> None:
    network = NETWORKS[0]
    stack = Trainable(network, shuffled(network, 1).double(), 0.0)
    x = torch.randn(5, 7, generator=torch.Generator().manual_seed(2)).double()
    stack.backward(torch.ones_like(stack(x)))
    for index in range(0, stack.packed.numel(), 37):
        values = []
        for step in (1e-6, -1e-6):
            moved = stack.packed.clone()
            moved[index] += step
            values.append(float(Stack(network, pieces(network, moved))(x).sum()))
        assert float(stack.grad[index]) == pytest.approx((values[0] - values[1]) / 2e-6, rel=1e-5, abs=1e-7)


def test_backward_without_parameters_leaves_their_gradients() -> None:
    network = NETWORKS[0]
    stack = Trainable(network, shuffled(network, 2), 0.0)
    stack.backward(torch.ones_like(stack(torch.ones(4, 7))), to_parameters=False, to_input=True)
    assert not stack.grad.any()


@pytest.mark.parametrize("clip", [None, 0.5])
def test_step_is_adam_with_clipping(clip: float | None) -> None:
    network = NETWORKS[0]
    parameters = shuffled(network, 2)
    stack = Trainable(network, parameters, 1e-3)
    leaf = parameters.clone().requires_grad_()
    adam = torch.optim.Adam([leaf], lr=1e-3)
    generator = torch.Generator().manual_seed(3)
    for _ in range(5):
        gradient = torch.randn(parameters.shape, generator=generator)
        stack.grad.copy_(pack(network, gradient))
        leaf.grad = gradient.clone()
        if clip is not None:
            torch.nn.utils.clip_grad_norm_([leaf], clip)
        stack.step(clip)
        adam.step()
    torch.testing.assert_close(stack.parameters(), leaf.detach(), rtol=1e-5, atol=1e-7)


def test_packing_keeps_every_parameter() -> None:
    network = NETWORKS[0]
    parameters = shuffled(network, 4)
    packed = pack(network, parameters)
    torch.testing.assert_close(unpack(network, packed), parameters, rtol=0, atol=0)
    for piece, view in zip(pieces(network, packed), views(network, parameters), strict=True):
        assert piece.is_contiguous()
        torch.testing.assert_close(piece, view, rtol=0, atol=0)


def test_only_weight_matrices_are_masked_in() -> None:
    network = actor_network(ActorSettings(width=9, hidden=2))
    mask = weight_mask(network)
    assert int(mask.sum()) == 7 * 9 + 9 * 9 + 9 * 9 + 9 * 3
    assert mask.shape == (n_parameters(network),)


@pytest.mark.parametrize("activation", ["tanh", "relu", "leaky_relu"])
@pytest.mark.parametrize("norm", ["none", "standard"])
def test_actors_in_flight_equal_the_exported_definition(activation: str, norm: str) -> None:
    network = actor_network(
        ActorSettings(width=12, hidden=2, activation=activation, layer_norm=norm, input_scale=SCALE)
    )
    parameters = shuffled(network, 3).numpy()
    observation = np.random.default_rng(4).normal(0.0, 0.2, (3, 5, 7)).astype(np.float32)
    u = Cast(network, parameters, 5)(observation)
    tensors = unflatten(network, parameters.astype(float))
    scale, offset = np.array(network.action_scale), np.array(network.action_offset)
    for e in range(5):
        expected = reference_forward(network, tensors, observation[:, e].astype(float))
        np.testing.assert_allclose(offset + scale * u[:, e], expected, atol=2e-6)
    learnt = Stack(network, views(network, torch.from_numpy(parameters)))(
        torch.from_numpy(observation * np.array(SCALE, dtype=np.float32))
    )
    np.testing.assert_allclose(u, learnt.numpy(), atol=2e-5)


def test_actor_has_the_shape_of_the_thesis() -> None:
    network = actor_network(ActorSettings())
    assert [layer.units for layer in network.layers] == [72, 72, 72, 72, 3]
    assert [layer.layer_norm for layer in network.layers] == ["none", "standard", "standard", "standard", "none"]
    assert network.action_scale == pytest.approx([np.deg2rad(10.0)] * 3)
    assert network.action_offset == (0.0, 0.0, 0.0)
