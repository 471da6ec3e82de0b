"""The imagination of a whole population as one ONNX graph (thesis eqs 8.2, 11, 12).

``export.rollout`` is the same in plain numpy, and its reference.

Inside the loop a node costs about as much to dispatch as to compute, so that the loop holds as few as possible:

- states are columns, (M, rows, A) for M models and A actors; whatever a step needs of them is one product with a matrix
  that is made before the loop (:mod:`export.stepping`);
- all policies are one product a layer (:mod:`export.actors`);
- commands wait in a queue at the end of the state, as long as the command lag and the delay ask for;
- altitude, reward, termination and safety are taken from the whole trajectory after the loop.
"""

from __future__ import annotations

import numpy as np
import onnx

from export.actors import Actors
from export.builder import Builder, value
from export.network import Network
from export.rollout import MAX_DELAY
from export.stepping import ACTING, MOVES, N_LINEAR, N_PRODUCTS, Step, observed_reference, products
from task.limits import DT
from task.model import N_REGRESSORS
from task.reward import (
    ALTITUDE_LIMIT,
    CRASH_COST_PER_FRAME,
    PHI_LIMIT,
    REWARD_SCALE,
    THETA_LIMIT,
    UNSAFE_ALPHA,
    UNSAFE_PHI,
)
from task.state import N_ACTION, N_IDENTIFIED, N_OBSERVATION, N_REFERENCE, STATE, TRACKED

BOOL, INT64 = onnx.TensorProto.BOOL, onnx.TensorProto.INT64
_HUGE = float(np.finfo(np.float32).max)
_END = np.iinfo(np.int64).max


def _slice(g: Builder, x: str, axis: int, start: int, end: int = _END, name: str | None = None) -> str:
    return g.op("Slice", x, g.integers(start), g.integers(end), g.integers(axis), name=name)


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


def _scores(g: Builder, before: str, after: str, reference: str) -> tuple[str, str]:
    """Add ``task.reward`` over trajectories: states before and after each step (H, M, 10, A), reference (H, 3) [rad].

    Returns the returns and the numbers of unsafe samples (eq. 14), (M, A) each.
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
    return tuple(g.op("ReduceSum", x, g.integers(0), keepdims=0) for x in (earned, count))  # type: ignore[return-value]


def _start(g: Builder, actors: Actors, count: int, lag: int) -> str:
    """Add what the loop starts from: L of :mod:`export.stepping`, (M, rows, A)."""
    of_network = g.op("Sub", "commands", g.constant(actors.offset, "offset"))
    sent = g.op("Div", of_network, g.constant(actors.unit, "unit"))
    # the command that acted last, and the lag + delay younger ones
    first = g.op("Sub", g.integers(MAX_DELAY), g.op("Reshape", "delay", g.integers(1)), name="first_command")
    recent = g.op("Slice", sent, first, g.integers(_END), g.integers(0), name="recent")
    parts = [
        g.constant(np.ones(1), "one"), "x", "dx", g.constant(np.zeros(N_PRODUCTS), "no_product"),
        g.op("Reshape", recent, g.integers(-1)),
    ]  # fmt: skip
    rows = g.op("Concat", *parts, axis=0)
    models = _slice(g, g.op("Shape", "model"), 0, 0, 1)
    shape = g.op("Concat", models, g.op("Shape", rows), g.integers(count), axis=0)
    return g.op("Expand", g.op("Unsqueeze", rows, g.integers(0, 2)), shape, name="linear_start")


def _widened(g: Builder, matrix: str, rank: int, waiting: str) -> str:
    """Return a map whose columns go on with zeros for the ``waiting`` (1,) rows behind those that it knows."""
    pads = g.op("Concat", g.integers(*[0] * (2 * rank - 1)), waiting, axis=0)
    return g.op("Pad", matrix, pads, name=f"{matrix}.widened")


def imagination(network: Network, parameters: np.ndarray, lag: int) -> onnx.ModelProto:
    """Return the rollout of all members and of the incumbent, in M models, as one graph.

    parameters: (P, K) float32, the members; lag: samples between a command and the increment that it moves, beyond
    that of eq. 8.2. Inputs and outputs as in docs/architecture.md: ``x``, ``dx``, ``commands``, ``delay``, ``model``,
    ``exact_kinematics``, ``reference``, ``incumbent`` -> ``returns`` and ``unsafe``, (M, P + 1) each.
    """
    count = parameters.shape[0] + 1
    g = Builder()
    actors = Actors(g, network, parameters)
    step = Step(g, network, actors.unit)
    now = _slice(g, "reference", 0, 0, -1, name="reference_now")
    following = _slice(g, "reference", 0, 1, name="reference_next")
    seen = observed_reference(g, now, network)
    start = _start(g, actors, count, lag)
    delayed = g.op("Mul", g.op("Reshape", "delay", g.integers(1)), g.integers(N_ACTION))

    b = Builder(outer=g, prefix="step/")
    linear = "step/linear"
    heights = (*MOVES, N_OBSERVATION + 1) if lag else MOVES

    def moves(maps: str, of: str) -> list[str]:
        names = ["flown", "base", "rates", "arguments", "observed"][: len(heights)]
        return b.ops("Split", b.op("MatMul", maps, of), b.integers(*heights), names=names, axis=1)

    def act(observed: str) -> str:
        s = b.op("Add", observed, "step/seen", name="s")
        return actors.act(b, b.op("Transpose", s, perm=[2, 0, 1], name="s_rows"))

    if lag:  # what acts now was sent before: one product gives the move and what the policies see
        waiting = g.op("Add", delayed, g.integers(N_ACTION * (lag - 1)))
        maps = _widened(g, g.op("Concat", step.moves, _per_model(g, step), axis=1, name="step_map"), 3, waiting)
        flown, base, rates, arguments, observed = moves(maps, linear)
        rows = [base, products(b, rates, arguments), _slice(b, linear, 1, ACTING), act(observed)]
    else:
        command = act(b.op("MatMul", _widened(g, step.observed, 2, delayed), linear))
        queue = b.op("Concat", linear, command, axis=1)
        flown, base, rates, arguments = moves(_widened(g, step.moves, 3, delayed), queue)
        rows = [base, products(b, rates, arguments), _slice(b, queue, 1, ACTING)]
    linear_next = b.op("Concat", *rows, axis=1, name="linear_next")

    shape = ("models", "rows", count)
    body = b.body(
        "step",
        [value(linear, shape), value("step/seen", (N_OBSERVATION + 1, 1))],
        [value(linear_next, shape), value(flown, ("models", N_IDENTIFIED, count))],
    )
    end, before = g.ops("Scan", start, seen, names=["linear_end", "before"], body=body, num_scan_inputs=1)
    last = g.op("MatMul", step.state, _slice(g, end, 1, 0, ACTING))
    after = g.op("Concat", _slice(g, before, 0, 1), g.op("Unsqueeze", last, g.integers(0)), axis=0, name="after")
    for name, of in zip(("returns", "unsafe"), _scores(g, before, after, following), strict=True):
        g.result(of, name)
    return g.model(
        "imagination",
        [
            value("x", (N_IDENTIFIED,)),
            value("dx", (N_IDENTIFIED,)),
            value("commands", (lag + 1 + MAX_DELAY, N_ACTION)),
            value("delay", (), INT64),
            value("model", ("models", N_REGRESSORS, N_IDENTIFIED)),
            value("exact_kinematics", (), BOOL),
            value("reference", ("samples", N_REFERENCE)),
            value("incumbent", (parameters.shape[1],)),
        ],
        [value(name, ("models", count)) for name in ("returns", "unsafe")],
        "Predicted return and unsafe samples of every member and, last, of the incumbent, in each model.",
    )


def _per_model(g: Builder, step: Step) -> str:
    """Return the observations' map beside the moves of each model: (M, 8, 33)."""
    wide = g.op("Concat", step.observed, g.constant(np.zeros((N_OBSERVATION + 1, N_ACTION)), "not_yet"), axis=1)
    shape = g.op("Shape", step.moves)
    models = _slice(g, shape, 0, 0, 1)
    return g.op("Expand", wide, g.op("Concat", models, g.integers(N_OBSERVATION + 1, N_LINEAR), axis=0))
