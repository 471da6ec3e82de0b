"""Actors in flight: a whole population's actions by a dozen numpy calls, without torch or allocation per layer."""

from __future__ import annotations

import numpy as np

from export.network import Network, unflatten


class _LayerInFlight:
    """One layer of P actors on E observations each.

    LayerNorm's subtraction of the mean is linear, so it is moved into weights and bias: the product is already
    centred.
    """

    def __init__(self, network: Network, index: int, tensors: dict[str, np.ndarray], flights: int) -> None:
        self.layer = network.layers[index]
        weight, bias = tensors[f"layers.{index}.weight"], tensors[f"layers.{index}.bias"]
        if index == 0:
            weight = weight * np.array(network.input_scale, dtype=np.float32)
        self.eps = np.float32(network.layer_norm_eps)
        self.slope = np.float32(network.leaky_slope)
        if self.layer.layer_norm != "none":
            weight = weight - weight.mean(axis=1, keepdims=True)
            bias = bias - bias.mean(axis=1, keepdims=True)
            self.gain = np.ascontiguousarray(tensors[f"layers.{index}.gain"][:, None])
            self.shift = np.ascontiguousarray(tensors[f"layers.{index}.shift"][:, None])
        self.weight = np.ascontiguousarray(weight.transpose(0, 2, 1))
        self.bias = np.ascontiguousarray(bias[:, None])
        self.h = np.empty((weight.shape[0], flights, self.layer.units), dtype=np.float32)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        h = np.matmul(x, self.weight, out=self.h)
        h += self.bias
        if self.layer.layer_norm != "none":
            square = np.einsum("pei,pei->pe", h, h)[..., None]
            h /= np.sqrt(square / np.float32(self.layer.units) + self.eps)
            h *= self.gain
            h += self.shift
        if self.layer.activation == "tanh":
            np.tanh(h, out=h)
        elif self.layer.activation == "relu":
            np.maximum(h, 0.0, out=h)
        elif self.layer.activation == "leaky_relu":
            np.maximum(h, self.slope * h, out=h)
        return h


class Cast:
    """P actors, each flying E aircraft, on the CPU."""

    def __init__(self, network: Network, parameters: np.ndarray, flights: int) -> None:
        """Prepare parameters (P, K) float32 for E = ``flights`` observations each."""
        tensors = unflatten(network, parameters)
        self.layers = [_LayerInFlight(network, i, tensors, flights) for i in range(len(network.layers))]

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return u in [-1, 1], shape (P, E, 3), for observations (P, E, 7) float32; reused by the next call."""
        h = observation
        for layer in self.layers:
            h = layer(h)
        return h
