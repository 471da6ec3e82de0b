"""One layer of P networks, forward and backward: as tensor operations for any device, and with kernels on the CPU.

A layer is h = f(LayerNorm(x W' + b)), with LayerNorm when the network has it. Both classes compute the same; the
one on the CPU also keeps its memory from call to call.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import leaky_relu_

from export.network import Layer, Network
from export.training import kernels

SIZES = 8
"""Batch sizes whose memory a layer keeps."""


def has_kernels(tensor: Tensor) -> bool:
    """Return whether the kernels serve such a tensor: single precision, on the CPU."""
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32


class LayerOnDevice:
    """A layer as tensor operations."""

    def __init__(self, layer: Layer, network: Network, part: dict[str, Tensor], into: dict[str, Tensor]) -> None:
        """Hold weight (P, units, in), bias, gain and shift (P, units), and where their gradients go, as they are."""
        self.layer, self.eps, self.slope = layer, network.layer_norm_eps, network.leaky_slope
        # Bias, gain and shift broadcast over the batch.
        self.part = {k: v if k == "weight" else v.unsqueeze(1) for k, v in part.items()}
        self.into = {k: v if k == "weight" else v.unsqueeze(1) for k, v in into.items()}

    def forward(self, x: Tensor) -> Tensor:
        """Return h (P, B, units) for x (P, B, in)."""
        self.x = x
        z = torch.baddbmm(self.part["bias"], x, self.part["weight"].transpose(1, 2))
        if self.layer.layer_norm != "none":
            self.normal, mean, rstd = torch.native_layer_norm(z, (self.layer.units,), None, None, self.eps)
            self.norm = z, mean, rstd
            z = torch.addcmul(self.part["shift"], self.normal, self.part["gain"])
        self.h = self._activate(z)
        return self.h

    def backward(self, grad: Tensor, to_parameters: bool, to_input: bool) -> Tensor:
        """Return d loss / d x where ``to_input``, d loss / d (x W') otherwise; write the parameters' gradients."""
        grad = self._activation_gradient(grad)
        if self.layer.layer_norm != "none":
            if to_parameters:
                torch.sum(grad * self.normal, 1, keepdim=True, out=self.into["gain"])
                torch.sum(grad, 1, keepdim=True, out=self.into["shift"])
            z, mean, rstd = self.norm
            grad = torch.ops.aten.native_layer_norm_backward(
                grad * self.part["gain"], z, (self.layer.units,), mean, rstd, None, None, (True, False, False)
            )[0]
        if to_parameters:
            torch.bmm(grad.transpose(1, 2), self.x, out=self.into["weight"])
            torch.sum(grad, 1, keepdim=True, out=self.into["bias"])
        return torch.bmm(grad, self.part["weight"]) if to_input else grad

    def _activate(self, z: Tensor) -> Tensor:
        """Return the activation of z, in the place of z."""
        if self.layer.activation == "tanh":
            return z.tanh_()
        if self.layer.activation == "relu":
            return z.relu_()
        if self.layer.activation == "leaky_relu":
            return leaky_relu_(z, self.slope)
        return z

    def _activation_gradient(self, grad: Tensor) -> Tensor:
        """Return d loss / d z from d loss / d h."""
        if self.layer.activation == "tanh":
            return torch.ops.aten.tanh_backward(grad, self.h)
        if self.layer.activation == "relu":
            return grad * (self.h > 0.0)
        if self.layer.activation == "leaky_relu":
            return torch.where(self.h > 0.0, grad, self.slope * grad)
        return grad


class _Buffers(NamedTuple):
    """Memory of one batch size B, as tensors and as arrays."""

    h: Tensor
    """(P, B, units) the product x W', then its activation."""
    grad: Tensor
    """(P, B, units) d loss / d h, then d loss / d (x W')."""
    to_x: Tensor
    """(P, B, in) d loss / d x."""
    arrays: tuple[np.ndarray, ...]
    """h, grad, the normalised x W' and 1 / sqrt(var + eps)."""


class LayerOnCPU:
    """A layer by two matrix products and one kernel each way (:mod:`export.training.kernels`)."""

    def __init__(self, layer: Layer, network: Network, part: dict[str, Tensor], into: dict[str, Tensor]) -> None:
        """See :class:`LayerOnDevice`."""
        self.weight = part["weight"]
        self.weight_t = part["weight"].transpose(1, 2)
        self.into_weight = into.get("weight")
        self.normalise = layer.layer_norm != "none"
        self.is_tanh = layer.activation == "tanh"
        slopes = {"relu": 0.0, "leaky_relu": network.leaky_slope}
        self.slope = np.float32(slopes.get(layer.activation, 1.0))
        self.eps = np.float32(network.layer_norm_eps)
        bias = part["bias"].numpy()
        gain, shift = (part[k].numpy() if k in part else bias for k in ("gain", "shift"))
        self.affine = bias, gain, shift
        into_bias = into["bias"].numpy() if into else np.empty_like(bias)
        gain, shift = (into[k].numpy() if k in into else into_bias for k in ("gain", "shift"))
        self.into = into_bias, gain, shift
        self._buffers: dict[int, _Buffers] = {}

    def _of(self, batch: int) -> _Buffers:
        if batch not in self._buffers:
            if len(self._buffers) == SIZES:
                self._buffers.clear()
            count, units, inputs = self.weight.shape
            h, grad = torch.empty(count, batch, units), torch.empty(count, batch, units)
            normal = np.empty((count, batch if self.normalise else 1, units), dtype=np.float32)
            rstd = np.empty((count, batch), dtype=np.float32)
            arrays = (h.numpy(), grad.numpy(), normal, rstd)
            self._buffers[batch] = _Buffers(h, grad, torch.empty(count, batch, inputs), arrays)
        return self._buffers[batch]

    def forward(self, x: Tensor) -> Tensor:
        """Return h (P, B, units) for x (P, B, in)."""
        own = self._of(x.shape[1])
        self.x, self.own = x, own
        torch.bmm(x, self.weight_t, out=own.h)
        h, _, normal, rstd = own.arrays
        bias, gain, shift = self.affine
        kernels.forward(h, bias, gain, shift, normal, rstd, h, self.normalise, self.is_tanh, self.slope, self.eps)
        return own.h

    def backward(self, grad: Tensor, to_parameters: bool, to_input: bool) -> Tensor:
        """Return d loss / d x where ``to_input``, d loss / d (x W') otherwise; write the parameters' gradients."""
        own = self.own
        own.grad.copy_(grad)
        h, g, normal, rstd = own.arrays
        gain = self.affine[1]
        kernels.backward(g, h, normal, rstd, gain, *self.into, to_parameters, self.normalise, self.is_tanh, self.slope)
        if to_parameters and self.into_weight is not None:
            torch.bmm(own.grad.transpose(1, 2), self.x, out=self.into_weight)
        return torch.bmm(own.grad, self.weight, out=own.to_x) if to_input else own.grad
