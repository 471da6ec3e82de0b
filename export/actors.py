"""All actors of a population at once, for the imagination's loop: weights prepared before it, few nodes within it."""

from __future__ import annotations

import numpy as np

from export.behaviour import activation
from export.builder import Builder
from export.network import Layer, Network, exceeds_limits, layout, unflatten
from task.limits import ACTION_HIGH, ACTION_LOW

SATURATED = 20.0
"""tanh of this is 1 in float32: the unit that carries a bias through a tanh layer."""

Tensors = dict[str, str]
"""One layer's tensors of all actors, by kind."""


class Actors:
    """Every member and, last, the incumbent, whose flat parameters are the graph's input ``incumbent``.

    Observations are rows that end in a constant one, and a layer without normalisation passes that one on, so that the
    next layer's bias is a row of its weight and costs no node. The centring of a LayerNorm is linear, and moves into
    weight and bias. ``unit`` (3,) [rad]: what a command of one means here; the scale of the actions is left to whoever
    uses them where that is possible.
    """

    def __init__(self, g: Builder, network: Network, parameters: np.ndarray) -> None:
        self._network = network
        scale = np.array(network.action_scale)
        self._scaled = bool((scale == 0.0).any())
        self.unit = np.ones_like(scale) if self._scaled else scale
        self.offset = np.zeros_like(scale) if self._scaled else np.array(network.action_offset)
        """Command at zero [rad]: command = offset + unit * what :meth:`act` gives."""
        tensors = layout(network)
        pieces = g.ops(
            "Split", "incumbent", g.integers(*(int(np.prod(t.shape)) for t in tensors)),
            names=[f"incumbent.{t.name}" for t in tensors], axis=0,
        )  # fmt: skip
        own = {t.name: g.op("Reshape", p, g.integers(1, *t.shape)) for t, p in zip(tensors, pieces, strict=True)}
        stacked = unflatten(network, parameters)
        cast = {t.name: g.constant(stacked[t.name], t.name) for t in tensors}
        self._layers: list[Tensors] = []
        self._carries = [True]
        """Whether the rows that enter a layer end in a one."""
        for i, layer in enumerate(network.layers):
            carries = layer.layer_norm == "none" and i < len(network.layers) - 1
            members, incumbent = (
                self._prepared(g, {kind: of[f"layers.{i}.{kind}"] for kind in _kinds(layer)}, layer, i, count, carries)
                for of, count in ((cast, len(parameters)), (own, 1))
            )
            self._layers.append({
                kind: g.op("Concat", members[kind], incumbent[kind], axis=0, name=f"all.{i}.{kind}") for kind in members
            })  # fmt: skip
            self._carries.append(carries)

    def _prepared(self, g: Builder, of: Tensors, layer: Layer, i: int, count: int, carries: bool) -> Tensors:
        """Return a layer's tensors as the loop wants them: weight (count, inputs, units), others (count, 1, units)."""
        made = {kind: g.op("Unsqueeze", of[kind], g.integers(1)) for kind in of if kind != "weight"}
        made["weight"] = g.op("Transpose", of["weight"], perm=[0, 2, 1])
        if layer.layer_norm != "none":
            for kind in ("weight", "bias"):
                mean = g.op("ReduceMean", made[kind], g.integers(-1), keepdims=1)
                made[kind] = g.op("Sub", made[kind], mean, name=f"centred.{kind}")
            if layer.layer_norm == "unbiased":
                root = g.constant(np.array(np.sqrt(layer.units - 1.0)), "root")
                made["gain"] = g.op("Mul", made["gain"], root, name="scaled.gain")
        one = np.full((count, 1, 1), SATURATED if layer.activation == "tanh" else 1.0)
        inputs = self._network.layers[i - 1].units if i else self._network.observation
        if carries:
            made["weight"] = self._beside(g, made["weight"], np.zeros((count, inputs, 1)))
            made["bias"] = self._beside(g, made["bias"], one)
        if self._carries[i]:
            made["weight"] = g.op("Concat", made["weight"], made.pop("bias"), axis=1, name="weight_and_bias")
        return made

    @staticmethod
    def _beside(g: Builder, x: str, column: np.ndarray) -> str:
        return g.op("Concat", x, g.constant(column, "unit_of_one"), axis=2)

    def act(self, g: Builder, rows: str) -> str:
        """Add all policies: scaled observations and a one (A, M, 8) -> commands in ``unit`` (M, 3, A)."""
        network, x = self._network, rows
        for i, (layer, tensors) in enumerate(zip(network.layers, self._layers, strict=True)):
            x = g.op("MatMul", x, tensors["weight"])
            if not self._carries[i]:
                x = g.op("Add", x, tensors["bias"])
            if layer.layer_norm != "none":
                x = _normalised(g, x, layer, network.layer_norm_eps, tensors)
            x = activation(g, x, layer, network)
        command = g.op("Transpose", x, perm=[1, 2, 0], name="command")
        if self._scaled:
            command = g.op("Mul", command, g.constant(np.array(network.action_scale)[:, None], "action_scale"))
            command = g.op("Add", command, g.constant(np.array(network.action_offset)[:, None], "action_offset"))
        if exceeds_limits(network):
            limits = np.sort([(limit - self.offset) / self.unit for limit in (ACTION_LOW, ACTION_HIGH)], axis=0)
            command = g.op("Max", command, g.constant(limits[0][:, None], "action_low"))
            command = g.op("Min", command, g.constant(limits[1][:, None], "action_high"))
        return command


def _kinds(layer: Layer) -> tuple[str, ...]:
    return ("weight", "bias") if layer.layer_norm == "none" else ("weight", "bias", "gain", "shift")


def _normalised(g: Builder, x: str, layer: Layer, eps: float, tensors: Tensors) -> str:
    """Add a LayerNorm of what is centred already; the gain of ``unbiased`` carries sqrt(units - 1)."""
    if layer.layer_norm == "standard":
        x = g.op("LayerNormalization", x, g.constant(np.ones(layer.units), "no_gain"), axis=-1, epsilon=eps)
    else:
        # c / (sqrt(c'c / (n - 1)) + eps) = sqrt(n - 1) c / (sqrt(c'c) + sqrt(n - 1) eps)
        length = g.op("ReduceL2", x, g.integers(-1), keepdims=1)
        norm = g.op("Add", length, g.constant(np.array(np.sqrt(layer.units - 1.0) * eps), "root_eps"), name="norm")
        x = g.op("Div", x, norm)
    return g.op("Add", g.op("Mul", x, tensors["gain"]), tensors["shift"], name="normalised")
