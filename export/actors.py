"""All actors of a population at once, for the imagination's loop: weights prepared before it, few nodes within it."""

from __future__ import annotations

import numpy as np

from export.behaviour import activation
from export.builder import Builder
from export.network import Layer, Network, exceeds_limits, layout, unflatten
from task.limits import ACTION_HIGH, ACTION_LOW

Tensors = dict[str, str]
"""One layer's tensors of all actors, by kind."""


class Actors:
    """Every member and, last, the incumbent, whose flat parameters are the graph's input ``incumbent``.

    Observations are rows that end in a constant one, so that the first bias is a row of its weight. The centring of a
    LayerNorm is linear, and moves into weight and bias. ``unit`` (3,) [rad]: what a command of one means here; the
    scale of the actions is left to whoever uses them where that is possible.
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
        for i, layer in enumerate(network.layers):
            kinds = ("weight", "bias") if layer.layer_norm == "none" else ("weight", "bias", "gain", "shift")
            members, incumbent = (
                self._prepared(g, {kind: of[f"layers.{i}.{kind}"] for kind in kinds}, layer, i) for of in (cast, own)
            )
            axis = 1 if i == len(network.layers) - 1 else 0
            self._layers.append({
                kind: g.op("Concat", members[kind], incumbent[kind], axis=axis, name=f"all.{i}.{kind}")
                for kind in members
            })  # fmt: skip

    def _prepared(self, g: Builder, of: Tensors, layer: Layer, i: int) -> Tensors:
        """Return a layer's tensors of n actors as the loop wants them.

        Hidden layers: weight (n, inputs, units), the others (n, 1, units). Output layer: weight (3, n, inputs), the
        others (3, n).
        """
        made = dict(of)
        if layer.layer_norm != "none":
            for kind in ("weight", "bias"):
                mean = g.op("ReduceMean", made[kind], g.integers(1), keepdims=1)
                made[kind] = g.op("Sub", made[kind], mean, name=f"centred.{kind}")
            if layer.layer_norm == "unbiased":
                root = g.constant(np.array(np.sqrt(layer.units - 1.0)), "root")
                made["gain"] = g.op("Mul", made["gain"], root, name="scaled.gain")
        first, output = i == 0, i == len(self._network.layers) - 1
        if first:
            made["weight"] = g.op("Concat", made["weight"], g.op("Unsqueeze", made.pop("bias"), g.integers(2)), axis=2)
        for kind, tensor in made.items():
            if output:
                made[kind] = g.op("Transpose", tensor, perm=[1, 0, 2] if kind == "weight" else [1, 0])
            elif kind == "weight":
                made[kind] = g.op("Transpose", tensor, perm=[0, 2, 1])
            else:
                made[kind] = g.op("Unsqueeze", tensor, g.integers(1))
        return made

    def act(self, g: Builder, rows: str) -> str:
        """Add all policies: scaled observations and a one (A, M, 8) -> commands in ``unit`` (M, 3, A)."""
        network, x = self._network, rows
        for i, (layer, tensors) in enumerate(zip(network.layers, self._layers, strict=True)):
            output = i == len(network.layers) - 1
            if output:
                # three units: a product and a sum are cheaper than one matrix product per actor
                x = g.op("Unsqueeze", g.op("Transpose", x, perm=[1, 0, 2], name="x_rows"), g.integers(1))
                x = g.op("ReduceSum", g.op("Mul", x, tensors["weight"]), g.integers(-1), keepdims=0)
            else:
                x = g.op("MatMul", x, tensors["weight"])
            if "bias" in tensors:
                x = g.op("Add", x, tensors["bias"])
            if layer.layer_norm != "none":
                x = _normalised(g, x, layer, network.layer_norm_eps, tensors, 1 if output else -1)
            x = activation(g, x, layer, network)
        if self._scaled:
            x = g.op("Mul", x, g.constant(np.array(network.action_scale)[:, None], "action_scale"))
            x = g.op("Add", x, g.constant(np.array(network.action_offset)[:, None], "action_offset"))
        if exceeds_limits(network):
            limits = np.sort([(limit - self.offset) / self.unit for limit in (ACTION_LOW, ACTION_HIGH)], axis=0)
            x = g.op("Max", x, g.constant(limits[0][:, None], "action_low"))
            x = g.op("Min", x, g.constant(limits[1][:, None], "action_high"))
        return x


def _normalised(g: Builder, x: str, layer: Layer, eps: float, tensors: Tensors, axis: int) -> str:
    """Add a LayerNorm of what is centred already; the gain of ``unbiased`` carries sqrt(units - 1)."""
    if layer.layer_norm == "standard" and axis == -1:
        x = g.op("LayerNormalization", x, g.constant(np.ones(layer.units), "no_gain"), axis=-1, epsilon=eps)
    elif layer.layer_norm == "standard":
        energy = g.op("ReduceMean", g.op("Mul", x, x), g.integers(axis), keepdims=1)
        x = g.op("Div", x, g.op("Sqrt", g.op("Add", energy, g.constant(np.array(eps), "eps"))))
    else:
        # c / (sqrt(c'c / (n - 1)) + eps) = sqrt(n - 1) c / (sqrt(c'c) + sqrt(n - 1) eps)
        length = g.op("ReduceL2", x, g.integers(axis), keepdims=1)
        norm = g.op("Add", length, g.constant(np.array(np.sqrt(layer.units - 1.0) * eps), "root_eps"), name="norm")
        x = g.op("Div", x, norm)
    return g.op("Add", g.op("Mul", x, tensors["gain"]), tensors["shift"], name="normalised")
