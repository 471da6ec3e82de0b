"""Multilayer perceptrons for many policies at once: one batched product per layer.

Parameters travel as (P, K), a row a member, as they are exported. For learning they are packed into one
vector (P * K,) in which each tensor (P, *shape) lies in one piece.

The actor of the thesis: Linear, tanh, then 3 x [Linear, LayerNorm, tanh], Linear, tanh. Its output u in
[-1, 1] is the action in units of the bound; the exported network adds action_offset + action_scale * u.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from export.network import Layer, Network, layout, n_parameters
from export.training import kernels
from export.training.config import ActorSettings, TD3Settings
from export.training.layers import LayerOnCPU, LayerOnDevice, has_kernels
from task.errors import UserError
from task.limits import ACTION_HIGH
from task.state import N_OBSERVATION


def actor_network(
    settings: ActorSettings,
    observation: int = N_OBSERVATION,
    action_scale: tuple[float, ...] = tuple(ACTION_HIGH.tolist()),
) -> Network:
    """Return the description of an actor that sees ``observation`` numbers; ``action_scale``: bound of each action.

    Raises UserError when the scales that the settings give do not fit these sizes.
    """
    inputs = settings.input_scale or (1.0,) * observation
    offset = settings.action_offset or (0.0,) * len(action_scale)
    for name, values, length in (("input_scale", inputs, observation), ("action_offset", offset, len(action_scale))):
        if len(values) != length:
            raise UserError(f"actor.{name}: expected {length} numbers for this task, got {len(values)}; give as many")
    plain = Layer(units=settings.width, activation=settings.activation)
    normalised = Layer(units=settings.width, layer_norm=settings.layer_norm, activation=settings.activation)
    return Network(
        layers=(plain, *[normalised] * settings.hidden, Layer(units=len(action_scale), activation="tanh")),
        observation=observation,
        action=len(action_scale),
        input_scale=inputs,
        action_scale=action_scale,
        action_offset=offset,
    )


def critic_network(actor: Network, settings: TD3Settings) -> Network:
    """Return the description of a critic Q(s, u): it sees the observation as the actor does, and u."""
    hidden = (
        Layer(units=units, layer_norm=settings.critic_layer_norm, activation=settings.critic_activation)
        for units in settings.critic_layers
    )
    return Network(
        layers=(*hidden, Layer(units=1, activation="linear")),
        observation=actor.observation + actor.action,
        action=1,
        input_scale=(*actor.input_scale, *[1.0] * actor.action),
        action_scale=(1.0,),
        action_offset=(0.0,),
    )


def views(network: Network, parameters: Tensor) -> list[Tensor]:
    """Return the tensors of ``parameters`` (P, K) in the layout's order, each (P, *shape), without copying."""
    return [parameters[:, t.offset : t.offset + math.prod(t.shape)].view(-1, *t.shape) for t in layout(network)]


def pieces(network: Network, packed: Tensor) -> list[Tensor]:
    """Return the tensors of a packed vector (P * K,) in the layout's order, each (P, *shape), without copying."""
    count = packed.numel() // n_parameters(network)
    return [
        packed[count * t.offset : count * (t.offset + math.prod(t.shape))].view(count, *t.shape)
        for t in layout(network)
    ]


def pack(network: Network, parameters: Tensor) -> Tensor:
    """Return parameters (P, K) as a packed vector (P * K,)."""
    return torch.cat([view.reshape(-1) for view in views(network, parameters)])


def unpack(network: Network, packed: Tensor) -> Tensor:
    """Return a packed vector as parameters (P, K)."""
    return torch.cat([piece.flatten(1) for piece in pieces(network, packed)], dim=1)


def weight_mask(network: Network) -> Tensor:
    """Return (K,) bool: True on weight matrices, which are all that mutation changes (as published)."""
    mask = torch.zeros(n_parameters(network), dtype=torch.bool)
    for row in layout(network):
        if row.name.endswith("weight"):
            mask[row.offset : row.offset + math.prod(row.shape)] = True
    return mask


def initialise(network: Network, count: int, generator: torch.Generator) -> Tensor:
    """Draw (count, K) parameters: uniform in +-1/sqrt(inputs), gains one, shifts zero. On the CPU."""
    flat = torch.zeros(count, n_parameters(network))
    inputs = network.observation
    for row, tensor in zip(layout(network), views(network, flat), strict=True):
        kind = row.name.rsplit(".", 1)[1]
        if kind == "weight":
            inputs = row.shape[1]
        if kind in ("weight", "bias"):
            tensor.uniform_(-1.0, 1.0, generator=generator).div_(math.sqrt(inputs))
        elif kind == "gain":
            tensor.fill_(1.0)
    return flat


class Stack:
    """P networks of one shape as one: forward and hand-derived backward, without autograd's bookkeeping."""

    def __init__(self, network: Network, tensors: list[Tensor], gradients: list[Tensor] | None = None) -> None:
        """Hold ``tensors`` (as from :func:`views` or :func:`pieces`) and where their gradients go, as they are."""
        self.network = network
        self.count = tensors[0].shape[0]
        parts: list[dict[str, Tensor]] = [{} for _ in network.layers]
        into: list[dict[str, Tensor]] = [{} for _ in network.layers]
        for i, row in enumerate(layout(network)):
            _, index, kind = row.name.split(".")
            parts[int(index)][kind] = tensors[i]
            if gradients:
                into[int(index)][kind] = gradients[i]
        kind_of_layer = LayerOnCPU if has_kernels(tensors[0]) else LayerOnDevice
        self._layers = [
            kind_of_layer(layer, network, part, to) for layer, part, to in zip(network.layers, parts, into, strict=True)
        ]

    def __call__(self, x: Tensor) -> Tensor:
        """Return the last layer's output (P, B, out): an actor's u in [-1, 1], a critic's Q.

        x: (P, B, in), or (B, in) for all alike, already multiplied by ``input_scale``. Remembers what
        :meth:`backward` needs. The next call with as many rows may reuse the result's memory.
        """
        h = x if x.dim() == 3 else x.expand(self.count, *x.shape)
        for layer in self._layers:
            h = layer.forward(h)
        return h

    def backward(self, grad: Tensor, to_parameters: bool = True, to_input: bool = False) -> Tensor:
        """Take d loss / d output (P, B, out) back through the last call.

        Overwrites the gradients where ``to_parameters``; returns d loss / d input (P, B, in) where
        ``to_input``, otherwise the gradient before the first layer's product.
        """
        for index in reversed(range(len(self._layers))):
            grad = self._layers[index].backward(grad, to_parameters, index > 0 or to_input)
        return grad


class Trainable(Stack):
    """A stack whose values, gradients and Adam moments are each one packed vector.

    So a handful of calls serve every tensor of every member: optimiser step, gradient norm, Polyak averaging.
    """

    BETAS = (0.9, 0.999)
    EPS = 1e-8

    def __init__(self, network: Network, parameters: Tensor, learning_rate: float) -> None:
        """Take a copy of ``parameters`` (P, K)."""
        self.learning_rate = learning_rate
        self.packed = pack(network, parameters)
        self.grad = torch.zeros_like(self.packed)
        self.mean = torch.zeros_like(self.packed)
        self.square = torch.zeros_like(self.packed)
        self.steps = 0
        super().__init__(network, pieces(network, self.packed), pieces(network, self.grad))

    def parameters(self) -> Tensor:
        """Return a copy of the parameters (P, K)."""
        return unpack(self.network, self.packed)

    def step(self, clip: float | None = None) -> None:
        """Clip the norm of all gradients together where asked, then take one step of Adam."""
        if has_kernels(self.packed):
            self._step_on_cpu(clip)
            return
        if clip is not None:
            self.grad.mul_((clip / (torch.linalg.vector_norm(self.grad) + 1e-6)).clamp_(max=1.0))
        self.steps += 1
        beta1, beta2 = self.BETAS
        self.mean.lerp_(self.grad, 1.0 - beta1)
        self.square.mul_(beta2).addcmul_(self.grad, self.grad, value=1.0 - beta2)
        root = (self.square / (1.0 - beta2**self.steps)).sqrt_().add_(self.EPS)
        self.packed.addcdiv_(self.mean, root, value=-self.learning_rate / (1.0 - beta1**self.steps))

    def _step_on_cpu(self, clip: float | None) -> None:
        vectors = [vector.numpy() for vector in (self.packed, self.grad, self.mean, self.square)]
        scale = 1.0 if clip is None else min(clip / (kernels.norm(vectors[1]) + 1e-6), 1.0)
        self.steps += 1
        beta1, beta2 = self.BETAS
        rate, root = self.learning_rate / (1.0 - beta1**self.steps), (1.0 - beta2**self.steps) ** -0.5
        kernels.adam(*vectors, *map(np.float32, (scale, beta1, beta2, rate, root, self.EPS)))

    def state(self) -> dict[str, Tensor]:
        """Return parameters and moments, for a checkpoint."""
        return {
            "packed": self.packed,
            "mean": self.mean,
            "square": self.square,
            "steps": torch.tensor(self.steps),
        }

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take up a checkpoint's parameters and moments."""
        for name in ("packed", "mean", "square"):
            getattr(self, name).copy_(state[name])
        self.steps = int(state["steps"])
