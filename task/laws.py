"""A classical law as a linear controller with memory and limits, as far ahead as an imagination looks.

A law sees, at every sample,

    y = [1; x (10); dx (10); acted (3); reference (3); d(reference)/dt (3)]

x: state; dx: its last increment; acted: the command that moved that increment [rad]; reference [rad] at this sample and
its rate [rad/s]. Heading and altitude read as zero, in x and in dx: an imagination does not fly them. With its memory
c, the law commands u and remembers c':

    [v; c'] = maps [c; y]        u = clip(v, ACTION_LOW, ACTION_HIGH) of task.limits

Whoever flies a law builds ``maps`` about the state it flies in; dynamic pressure, trim and whatever else bends slowly
are constants in them. The memory does not know of the limit, unless the law reads it back from ``acted``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.state import N_ACTION, N_IDENTIFIED, N_REFERENCE, STATE

N_MEMORY = 8
"""Length of c; a law that needs less leaves rows and columns of zeros."""


class Seen(NamedTuple):
    """Where each part of y lies; columns of ``maps`` are N_MEMORY further on."""

    one: slice
    x: slice
    """``task.state.STATE``, the first ten."""
    dx: slice
    acted: slice
    """``task.state.ACTION`` [rad]."""
    reference: slice
    """``task.state.REFERENCE`` [rad]."""
    rate: slice
    """d/dt of the reference [rad/s]."""


_ENDS = np.cumsum([1, N_IDENTIFIED, N_IDENTIFIED, N_ACTION, N_REFERENCE, N_REFERENCE]).tolist()
SEEN = Seen(*(slice(start, end) for start, end in zip([0, *_ENDS[:-1]], _ENDS, strict=True)))
N_SEEN: int = _ENDS[-1]
"""Length of y."""

_READ = np.array([float(i not in (STATE.psi, STATE.h)) for i in range(N_IDENTIFIED)])
READ = np.concatenate([np.ones(1), _READ, _READ, np.ones(N_SEEN - SEEN.dx.stop)])
"""Mask (N_SEEN,) of y: zero for what reads as zero."""


class LinearLaw(NamedTuple):
    """A law at the moment in which its future is asked for."""

    maps: np.ndarray
    """(3 + N_MEMORY, N_MEMORY + N_SEEN): rows [v; c'], columns [c; y]."""
    memory: np.ndarray
    """c (N_MEMORY,)."""


def reference_rates(reference: np.ndarray, dt: float = DT) -> np.ndarray:
    """Return d(reference)/dt [rad/s] at all rows of ``reference`` (H + 1, 3) [rad] but the last: (H, 3), H >= 1.

    Backward differences; the first row, before which nothing is known, has the forward one.
    """
    steps = np.diff(reference, axis=0) / dt
    return np.concatenate([steps[:1], steps[:-1]])


def seen(x: np.ndarray, dx: np.ndarray, acted: np.ndarray, reference: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return y (..., 30).

    x, dx: (..., 10); acted: (..., 3) [rad]; reference: (..., 3) [rad]; rate: (..., 3) [rad/s]. The last three may lack
    the dimensions in front.
    """
    alike = [np.broadcast_to(part, (*x.shape[:-1], part.shape[-1])) for part in (acted, reference, rate)]
    return np.concatenate([np.ones_like(x[..., :1]), x, dx, *alike], axis=-1) * READ.astype(x.dtype)


def step(maps: np.ndarray, memory: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the commands u (..., 3) [rad] and the next memory (..., N_MEMORY) of laws.

    maps: (..., 3 + N_MEMORY, N_MEMORY + N_SEEN); memory: c (..., N_MEMORY); y: (..., N_SEEN).
    """
    both = np.matmul(maps, np.concatenate([memory, y], axis=-1)[..., None])[..., 0]
    return both[..., :N_ACTION].clip(ACTION_LOW, ACTION_HIGH), both[..., N_ACTION:]
