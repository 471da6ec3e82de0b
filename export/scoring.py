"""Reward, loss, safety and surface travel of imagined flights, from whole trajectories after the loop (eqs 12-14)."""

from __future__ import annotations

import numpy as np
import onnx

from export.builder import Builder
from task.limits import DT
from task.reward import (
    ALTITUDE_LIMIT,
    CRASH_COST_PER_FRAME,
    PHI_LIMIT,
    REWARD_SCALE,
    THETA_LIMIT,
    UNSAFE_ALPHA,
    UNSAFE_PHI,
)
from task.state import N_IDENTIFIED, STATE, TRACKED

_HUGE = float(np.finfo(np.float32).max)


def _altitude(g: Builder, before: str, after: str) -> str:
    """Add h of ``task.model`` after each step from states before and after it, (H, M, 10, A) -> (H, M, 1, A)."""

    def rows(x: str, *states: STATE) -> str:
        return g.op("Gather", x, g.integers(*states), axis=2)

    half = g.constant(np.array(0.5), "half")
    speed, alpha, beta = (
        g.op("Mul", g.op("Add", rows(before, state), rows(after, state)), half)
        for state in (STATE.V, STATE.alpha, STATE.beta)
    )
    angles = (alpha, beta, rows(before, STATE.phi), rows(before, STATE.theta))
    (sin_a, cos_a), (sin_b, cos_b), (sin_phi, cos_phi), (sin_theta, cos_theta) = (
        (g.op("Sin", angle), g.op("Cos", angle)) for angle in angles
    )

    def product(*factors: str) -> str:
        total = factors[0]
        for factor in factors[1:]:
            total = g.op("Mul", total, factor)
        return total

    up = g.op("Sub", product(cos_a, cos_b, sin_theta), product(sin_b, sin_phi, cos_theta))
    climb = g.op("Sub", up, product(sin_a, cos_b, cos_phi, cos_theta))
    gained = product(speed, climb, g.constant(np.array(DT), "dt"), "exact")
    total = g.op("CumSum", gained, g.constant(np.array(0), "first_axis"))
    return g.op("Add", rows(after, STATE.h), total, name="altitude")


SCORES = ("returns", "unsafe", "travel")
"""What :func:`scores` returns, by the names of the graphs' outputs."""


def scores(g: Builder, before: str, after: str, moved: str, reference: str) -> tuple[str, str, str]:
    """Add ``task.reward`` over trajectories, and how far surfaces are moved.

    before, after: states around each step (H, M, 10, A); moved: increments of the commands that act (H, M, 3, A) [rad];
    reference: (H, 3) [rad]. Returns the returns, the numbers of unsafe samples (eq. 14), and how far the surfaces are
    moved until the flight is lost [rad], all surfaces together; (M, A) each.
    """
    channels = g.op("Gather", after, g.integers(*TRACKED), axis=2, name="tracked")
    error = g.op("Sub", g.op("Unsqueeze", reference, g.integers(1, 3)), channels, name="error")
    scaled = g.op("Mul", error, g.constant(REWARD_SCALE[:, None], "reward_scale"))
    one = g.constant(np.array(1.0), "plus_one")
    clipped = g.op("Abs", g.op("Clip", scaled, g.constant(np.array(-1.0), "minus_one"), one))
    reward = g.op("Mul", g.op("ReduceSum", clipped, g.integers(2), keepdims=0), g.constant(np.array(-1 / 3), "mean"))

    bounds = np.full((N_IDENTIFIED, 1), _HUGE)
    bounds[[STATE.theta, STATE.phi], 0] = THETA_LIMIT, PHI_LIMIT
    # A comparison with NaN is false, one with infinity fails against the largest float: not finite is outside.
    bounded = g.op("LessOrEqual", g.op("Abs", after), g.constant(bounds, "bound"))
    high = g.op("GreaterOrEqual", _altitude(g, before, after), g.constant(np.array(ALTITUDE_LIMIT), "floor"))
    inside = g.op("Concat", *(g.op("Cast", x, to=onnx.TensorProto.FLOAT) for x in (bounded, high)), axis=2)
    all_inside = g.op("ReduceMin", inside, g.integers(2), keepdims=0, name="inside")
    # lost once, lost for good: alive while every sample so far is inside
    outside_so_far = g.op("CumSum", g.op("Sub", one, all_inside), g.constant(np.array(0), "first_axis"))
    alive = g.op("Less", outside_so_far, g.constant(np.array(0.5), "half"), name="alive")
    earned = g.op("Where", alive, reward, g.constant(np.array(-CRASH_COST_PER_FRAME), "crash"), name="earned")

    angles = g.op("Gather", after, g.integers(STATE.alpha, STATE.phi), axis=2)
    alpha, phi = g.ops("Split", angles, names=["alpha", "phi"], axis=2, num_outputs=2)
    steep = g.op("GreaterOrEqual", g.op("Abs", phi), g.constant(np.array(UNSAFE_PHI), "unsafe_phi"))
    stalling = g.op("GreaterOrEqual", alpha, g.constant(np.array(UNSAFE_ALPHA), "unsafe_alpha"))
    unsafe = g.op("And", g.op("Squeeze", g.op("Or", steep, stalling), g.integers(2)), alive, name="unsafe_now")
    count = g.op("Cast", unsafe, to=onnx.TensorProto.FLOAT)
    path = g.op("ReduceSum", g.op("Abs", moved), g.integers(2), keepdims=0)
    travel = g.op("Where", alive, path, g.constant(np.array(0.0), "at_rest"), name="travelled")
    return tuple(g.op("ReduceSum", x, g.integers(0), keepdims=0) for x in (earned, count, travel))  # type: ignore[return-value]
