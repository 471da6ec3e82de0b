"""The behavioural policy as an ONNX graph whose parameters are inputs, so that they can change in flight."""

from __future__ import annotations

import numpy as np
import onnx

from export.builder import Builder, value
from export.network import Layer, Network, layout


def activation(g: Builder, x: str, layer: Layer, network: Network) -> str:
    """Add a layer's activation."""
    if layer.activation == "tanh":
        return g.op("Tanh", x)
    if layer.activation == "relu":
        return g.op("Relu", x)
    if layer.activation == "leaky_relu":
        return g.op("LeakyRelu", x, alpha=network.leaky_slope)
    return x


def _layer_norm(g: Builder, x: str, i: int, layer: Layer, eps: float) -> str:
    gain, shift = f"layers.{i}.gain", f"layers.{i}.shift"
    if layer.layer_norm == "standard":
        return g.op("LayerNormalization", x, gain, shift, axis=-1, epsilon=eps)
    axes = g.integers(-1)
    centred = g.op("Sub", x, g.op("ReduceMean", x, axes, keepdims=1), name="centred")
    # |centred|_2 = sqrt(units - 1) * unbiased standard deviation
    root = np.sqrt(layer.units - 1.0)
    norm = g.op("Add", g.op("ReduceL2", centred, axes, keepdims=1), g.constant(np.array([root * eps]), "root_eps"))
    unit = g.op("Div", g.op("Mul", centred, g.constant(np.array([root]), "root")), norm, name="normalised")
    return g.op("Add", g.op("Mul", unit, gain), shift)


def behaviour(network: Network) -> onnx.ModelProto:
    """Return the policy: ``observation`` (1, 7) and every parameter tensor by name -> ``action`` (1, 3) [rad]."""
    g = Builder()
    x = "observation"
    if any(scale != 1.0 for scale in network.input_scale):
        x = g.op("Mul", x, g.constant(np.array([network.input_scale]), "input_scale"))
    for i, layer in enumerate(network.layers):
        x = g.op("Gemm", x, f"layers.{i}.weight", f"layers.{i}.bias", transB=1)
        if layer.layer_norm != "none":
            x = _layer_norm(g, x, i, layer, network.layer_norm_eps)
        x = activation(g, x, layer, network)
    x = g.op("Mul", x, g.constant(np.array([network.action_scale]), "action_scale"))
    if any(network.action_offset):
        x = g.op("Add", x, g.constant(np.array([network.action_offset]), "action_offset"))
    g.nodes[-1].output[0] = "action"
    return g.model(
        "behaviour",
        [value("observation", (1, network.observation)), *(value(t.name, t.shape) for t in layout(network))],
        [value("action", (1, network.action))],
        "Behavioural policy; its parameters are inputs.",
    )
