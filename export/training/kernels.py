"""What lies between two matrix products of a multilayer perceptron, and Adam, each in one pass over its data (CPU).

On tensors as small as TD3's a call for every elementwise operation costs more than the products. These loops do what
:class:`export.training.networks.Stack` writes as tensor operations for other devices; the two are tested against
each other and against autograd.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TANH_LIMIT = np.float32(7.90531110763549805)
"""Beyond it tanh is one in single precision."""
NUMERATOR = np.array(
    [4.89352455891786e-03, 6.37261928875436e-04, 1.48572235717979e-05, 5.12229709037114e-08,
     -8.60467152213735e-11, 2.00018790482477e-13, -2.76076847742355e-16], dtype=np.float32
)  # fmt: skip
DENOMINATOR = np.array(
    [4.89352518554385e-03, 2.26843463243900e-03, 1.18534705686654e-04, 1.19825839466702e-06], dtype=np.float32
)
"""Rational approximation of tanh in odd and even powers (the one of Eigen): a few units in the last place."""
N0, N1, N2, N3, N4, N5, N6 = NUMERATOR
D0, D1, D2, D3 = DENOMINATOR
ONE = np.float32(1.0)

fast = njit(cache=True, fastmath={"reassoc", "contract", "arcp", "nsz"}, nogil=True, error_model="numpy")


@fast
def tanh_row(h):  # type: ignore[no-untyped-def]
    """Replace a row (U,) by its hyperbolic tangent; not a number stays not a number."""
    for j in range(h.shape[0]):
        x = h[j]
        x = TANH_LIMIT if x > TANH_LIMIT else x
        x = -TANH_LIMIT if x < -TANH_LIMIT else x
        y = x * x
        n = x * (N0 + y * (N1 + y * (N2 + y * (N3 + y * (N4 + y * (N5 + y * N6))))))
        h[j] = n / (D0 + y * (D1 + y * (D2 + y * D3)))


@fast
def bend_row(h, slope):  # type: ignore[no-untyped-def]
    """Multiply the negative ones of a row (U,) by ``slope``: 0 is ReLU, 1 leaves the row as it is."""
    for j in range(h.shape[0]):
        h[j] = h[j] if h[j] > 0 else slope * h[j]


@fast
def forward(z, bias, gain, shift, normal, rstd, h, normalise, is_tanh, slope, eps):  # type: ignore[no-untyped-def]
    """From products z (P, B, U) to activations h (P, B, U), all float32.

    bias, gain, shift: (P, U); with ``normalise`` the LayerNorm's (z - mean) / sqrt(var + eps) is left in
    ``normal`` (P, B, U) and 1 / sqrt(var + eps) in ``rstd`` (P, B).
    """
    count, batch, units = z.shape
    share = ONE / np.float32(units)
    for p in range(count):
        for b in range(batch):
            row, out = z[p, b], h[p, b]
            if normalise:
                n = normal[p, b]
                total = np.float32(0.0)
                for j in range(units):
                    n[j] = row[j] + bias[p, j]
                    total += n[j]
                mean = total * share
                square = np.float32(0.0)
                for j in range(units):
                    n[j] -= mean
                    square += n[j] * n[j]
                r = ONE / np.float32(math.sqrt(square * share + eps))
                rstd[p, b] = r
                for j in range(units):
                    n[j] *= r
                    out[j] = n[j] * gain[p, j] + shift[p, j]
            else:
                for j in range(units):
                    out[j] = row[j] + bias[p, j]
            if is_tanh:
                tanh_row(out)
            elif slope != ONE:
                bend_row(out, slope)


@fast
def backward(grad, h, normal, rstd, gain, to_bias, to_gain, to_shift, sums, normalise, is_tanh, slope):  # type: ignore[no-untyped-def]
    """From d loss / d h in ``grad`` (P, B, U), which is overwritten, to d loss / d z; the other names as in forward.

    With ``sums`` the gradients (P, U) of bias, gain and shift are written too.
    """
    count, batch, units = grad.shape
    share = ONE / np.float32(units)
    for p in range(count):
        if sums:
            to_bias[p] = 0.0
            if normalise:
                to_gain[p] = 0.0
                to_shift[p] = 0.0
        for b in range(batch):
            g, a = grad[p, b], h[p, b]
            if is_tanh:
                for j in range(units):
                    g[j] *= ONE - a[j] * a[j]
            elif slope != ONE:
                for j in range(units):
                    g[j] = g[j] if a[j] > 0 else slope * g[j]
            if normalise:
                n = normal[p, b]
                if sums:
                    for j in range(units):
                        to_shift[p, j] += g[j]
                        to_gain[p, j] += g[j] * n[j]
                mean, along = np.float32(0.0), np.float32(0.0)
                for j in range(units):
                    g[j] *= gain[p, j]
                    mean += g[j]
                    along += g[j] * n[j]
                mean *= share
                along *= share
                r = rstd[p, b]
                for j in range(units):
                    g[j] = r * (g[j] - mean - along * n[j])
            if sums:
                for j in range(units):
                    to_bias[p, j] += g[j]


@fast
def adam(value, grad, mean, square, scale, beta1, beta2, rate, root_correction, eps):  # type: ignore[no-untyped-def]
    """One step of Adam on vectors (K,), in place, with the gradient times ``scale``.

    rate: learning rate / (1 - beta1^t); root_correction: 1 / sqrt(1 - beta2^t).
    """
    for i in range(value.shape[0]):
        g = scale * grad[i]
        m = beta1 * mean[i] + (ONE - beta1) * g
        v = beta2 * square[i] + (ONE - beta2) * g * g
        mean[i] = m
        square[i] = v
        value[i] -= rate * m / (np.float32(math.sqrt(v)) * root_correction + eps)


@fast
def norm(x):  # type: ignore[no-untyped-def]
    """Return the Euclidean norm of a vector (K,)."""
    total = np.float32(0.0)
    for i in range(x.shape[0]):
        total += x[i] * x[i]
    return math.sqrt(total)


@fast
def follow(target, value, tau):  # type: ignore[no-untyped-def]
    """Move ``target`` (K,) by ``tau`` of the way to ``value``."""
    for i in range(target.shape[0]):
        target[i] += tau * (value[i] - target[i])
