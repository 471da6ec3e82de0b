"""Any stack of MLP actors of one shape: its description, its flat parameters, its reference forward pass.

An actor is action = action_offset + action_scale * net(input_scale * s); a layer is Linear, then LayerNorm when it
has one, then its activation. This numpy forward is the reference of every exported graph.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np

from task.config import Settings
from task.errors import UserError
from task.limits import ACTION_HIGH, ACTION_LOW
from task.state import N_ACTION, N_OBSERVATION

LayerNorm = Literal["none", "standard", "unbiased"]
Activation = Literal["tanh", "relu", "leaky_relu", "linear"]


class Layer(Settings, frozen=True):
    """One layer: Linear, LayerNorm when it has one, activation."""

    units: int
    """Number of outputs."""
    layer_norm: LayerNorm = "none"
    """``standard``: gain * (x - mean) / sqrt(biased variance + eps) + shift; ``unbiased``: gain * (x - mean) /
    (unbiased standard deviation + eps) + shift."""
    activation: Activation = "tanh"


class Network(Settings, frozen=True):
    """The shape that all actors of a population share, with the scales inside it."""

    layers: tuple[Layer, ...]
    """From the first hidden layer to the output layer."""
    observation: int = N_OBSERVATION
    """Number of inputs."""
    action: int = N_ACTION
    """Number of outputs."""
    input_scale: tuple[float, ...] = (1.0,) * N_OBSERVATION
    """Multiplied onto the observation [1/unit of the observation], one per input."""
    layer_norm_eps: float = 1e-5
    """Added to the variance (``standard``) or to the standard deviation (``unbiased``)."""
    leaky_slope: float = 0.01
    """Slope of ``leaky_relu`` below zero."""
    action_scale: tuple[float, ...] = tuple(ACTION_HIGH.tolist())
    """Action per unit of the last layer's output [rad], one per surface."""
    action_offset: tuple[float, ...] = (0.0,) * N_ACTION
    """Action at zero output [rad], one per surface."""


class Tensor(Settings, frozen=True):
    """Where one parameter tensor lies in an actor's flat parameter vector; row-major."""

    name: str
    shape: tuple[int, ...]
    offset: int


def validate(network: Network, where: str) -> None:
    """Raise UserError, naming ``where``, unless the description is one that the runtime can fly."""

    def refuse(what: str, expected: object, got: object) -> None:
        raise UserError(f"{where}: network.{what}: expected {expected}, got {got}")

    if network.observation != N_OBSERVATION:
        refuse("observation", f"the task's {N_OBSERVATION} inputs", network.observation)
    if network.action != N_ACTION:
        refuse("action", f"the task's {N_ACTION} surfaces", network.action)
    if not network.layers:
        refuse("layers", "at least the output layer", "none")
    if network.layers[-1].units != N_ACTION:
        refuse("layers[-1].units", f"{N_ACTION}, one per surface", network.layers[-1].units)
    for i, layer in enumerate(network.layers):
        least = 1 if layer.layer_norm == "none" else 2
        if layer.units < least:
            refuse(f"layers[{i}].units", f"at least {least} with layer_norm {layer.layer_norm}", layer.units)
    for name, length in (("input_scale", N_OBSERVATION), ("action_scale", N_ACTION), ("action_offset", N_ACTION)):
        values = getattr(network, name)
        if len(values) != length or not all(map(math.isfinite, values)):
            refuse(name, f"{length} finite numbers", values)
    if not (math.isfinite(network.layer_norm_eps) and network.layer_norm_eps > 0.0):
        refuse("layer_norm_eps", "a positive number", network.layer_norm_eps)
    if not math.isfinite(network.leaky_slope):
        refuse("leaky_slope", "a finite number", network.leaky_slope)


def layout(network: Network) -> tuple[Tensor, ...]:
    """Return the parameter tensors in the order of the flat vector."""
    tensors: list[Tensor] = []
    offset = 0
    inputs = network.observation
    for i, layer in enumerate(network.layers):
        shapes: dict[str, tuple[int, ...]] = {"weight": (layer.units, inputs), "bias": (layer.units,)}
        if layer.layer_norm != "none":
            shapes |= {"gain": (layer.units,), "shift": (layer.units,)}
        for kind, shape in shapes.items():
            tensors.append(Tensor(name=f"layers.{i}.{kind}", shape=shape, offset=offset))
            offset += math.prod(shape)
        inputs = layer.units
    return tuple(tensors)


def n_parameters(network: Network) -> int:
    """Return K, the number of parameters of one actor."""
    last = layout(network)[-1]
    return last.offset + math.prod(last.shape)


def flatten(network: Network, tensors: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return stacked tensors {name: (P, *shape)} as one matrix (P, K) in the layout's order, float32.

    Raises UserError when a tensor is missing, unknown or of another shape.
    """
    expected = {t.name: t.shape for t in layout(network)}
    if set(tensors) != set(expected):
        wrong = sorted(set(tensors) ^ set(expected))
        raise UserError(f"stacked parameters: expected the tensors {', '.join(expected)}; missing or unknown: {wrong}")
    members = next(iter(tensors.values())).shape[0]
    rows = []
    for name, shape in expected.items():
        if tensors[name].shape != (members, *shape):
            raise UserError(f"stacked parameters: {name}: expected {(members, *shape)}, got {tensors[name].shape}")
        rows.append(tensors[name].reshape(members, -1))
    return np.concatenate(rows, axis=1).astype(np.float32)


def unflatten(network: Network, parameters: np.ndarray) -> dict[str, np.ndarray]:
    """Return flat parameters (..., K) as views {name: (..., *shape)}."""
    return {
        t.name: parameters[..., t.offset : t.offset + math.prod(t.shape)].reshape(*parameters.shape[:-1], *t.shape)
        for t in layout(network)
    }


def exceeds_limits(network: Network) -> bool:
    """Return whether an actor could command more than the limits of the task, so that the gate would cut it."""
    offset, scale = np.array(network.action_offset), np.abs(network.action_scale)
    if network.layers[-1].activation != "tanh":
        return True
    margin = 1e-9  # the limits as written in a description may differ from the task's in the last digit
    return bool(((offset + scale > ACTION_HIGH + margin) | (offset - scale < ACTION_LOW - margin)).any())


def _activate(x: np.ndarray, activation: Activation, leaky_slope: float) -> np.ndarray:
    if activation == "tanh":
        return np.tanh(x)
    if activation == "relu":
        return np.maximum(x, 0.0)
    if activation == "leaky_relu":
        return np.where(x >= 0.0, x, leaky_slope * x)
    return x


def _normalise(x: np.ndarray, layer_norm: LayerNorm, eps: float) -> np.ndarray:
    centred = x - x.mean(axis=-1, keepdims=True)
    if layer_norm == "standard":
        return centred / np.sqrt(x.var(axis=-1, keepdims=True) + eps)
    return centred / (x.std(axis=-1, ddof=1, keepdims=True) + eps)


def forward(network: Network, tensors: Mapping[str, np.ndarray], s: np.ndarray) -> np.ndarray:
    """Return the actions [rad], shape (P, 3), of P actors, each on its own observation.

    tensors: {name: (P, *shape)} from :func:`unflatten`; s: (P, 7), or (7,) for the same to all. Computes in the
    precision of its inputs; no limit is applied.
    """
    x = s * np.array(network.input_scale, dtype=s.dtype)
    for i, layer in enumerate(network.layers):
        # (P, 1, inputs) @ (P, inputs, units): one small product per actor
        x = np.matmul(x[..., None, :], np.swapaxes(tensors[f"layers.{i}.weight"], -1, -2))[..., 0, :]
        x = x + tensors[f"layers.{i}.bias"]
        if layer.layer_norm != "none":
            x = _normalise(x, layer.layer_norm, network.layer_norm_eps)
            x = x * tensors[f"layers.{i}.gain"] + tensors[f"layers.{i}.shift"]
        x = _activate(x, layer.activation, network.leaky_slope)
    return np.array(network.action_offset, dtype=x.dtype) + np.array(network.action_scale, dtype=x.dtype) * x
