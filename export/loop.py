"""The loop of an imagination: flights in the incremental model (eq. 8.2), whoever acts in them.

Inside the loop a node costs about as much to dispatch as to compute, so that the loop holds as few as possible:

- states are columns, (M, rows, A) for M models and A actors; whatever a step needs of them is one product with a matrix
  that is made before the loop (:mod:`export.stepping`);
- commands wait in a queue at the end of the state, as long as the command lag and the delay ask for;
- actuators without limits, as most are, fly in a loop of their own, which pays nothing for what the other one limits
  (:mod:`export.limiting`);
- altitude, reward, termination and safety are taken from the whole trajectory after the loop (:mod:`export.scoring`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import onnx

from export.builder import END, Builder, Shape, value
from export.limiting import Limits
from export.rollout import MAX_DELAY
from export.stepping import ACTING, MOVES, N_FLOWN, N_PRODUCTS, Step, products
from task.actuators import N_ACTUATOR
from task.model import N_REGRESSORS
from task.state import N_ACTION, N_IDENTIFIED, N_REFERENCE

SCAN_INPUT = "step/seen"
"""What the pilots need of the reference, sample by sample, within the loop."""
FREE_LOOP, LIMITED_LOOP = "free", "limited"
"""The loops of actuators without limits of their own, and with."""
_LINEAR = "step/linear"


class Pilots(NamedTuple):
    """Who acts, and how the loop's product serves them."""

    moves: str
    """(M, 52, own + 33): ``moves`` of a step, of what is the actors' own and L."""
    sees: str
    """(M, n, own + 33): what they act upon; zero for the command that acts now."""
    heights: tuple[int, ...]
    """Rows of ``sees``, as :attr:`act` wants them split."""
    own: int
    """Rows ahead of L that belong to the pilots."""
    act: Callable[..., tuple[list[str], str]]
    """From the body's builder and the split ``sees``: own rows of the next state, and the commands (M, 3, A)."""
    number: int
    """A."""
    dimension: str = "models"
    """What the first dimension counts, by its name in the graph."""


def first_rows(g: Builder, limits: Limits, lag: int) -> str:
    """Add L of :mod:`export.stepping` as the flights begin, (rows,)."""
    # the command that acted last, and the lag + delay younger ones
    first = g.op("Sub", g.integers(MAX_DELAY), g.op("Reshape", "delay", g.integers(1)), name="first_command")
    recent = g.op("Slice", limits.rows(g, "commands"), first, g.integers(END), g.integers(0), name="recent")
    parts = [
        g.constant(np.ones(1), "one"), "x", "dx", g.constant(np.zeros(N_PRODUCTS), "no_product"),
        g.op("Reshape", limits.waiting(g, recent, lag), g.integers(-1)),
    ]  # fmt: skip
    return g.op("Concat", *parts, axis=0)


def _rows_waiting(g: Builder, lag: int) -> str:
    """Add the number (1,) of rows of the queue behind those that every L has."""
    delayed = g.op("Mul", g.op("Reshape", "delay", g.integers(1)), g.integers(N_ACTION))
    return g.op("Add", delayed, g.integers(N_ACTION * (lag - 1))) if lag else delayed


def _widened(g: Builder, matrix: str, waiting: str) -> str:
    """Return maps (M, n, columns) whose columns go on with zeros for the ``waiting`` (1,) rows of the queue."""
    pads = g.op("Concat", g.integers(0, 0, 0, 0, 0), waiting, axis=0)
    return g.op("Pad", matrix, pads, name=f"{matrix}.widened")


def fly(
    g: Builder, pilots: Pilots, step: Step, limits: Limits, start: str, seen: str, seen_shape: Shape, lag: int
) -> tuple[str, str, str]:
    """Add the loops; return the states before and after each of H steps, and what the commands that act moved by.

    start: (M, own + rows, A); seen: (H, *seen_shape), the body's input :data:`SCAN_INPUT`. States are (H, M, 10, A),
    moves (H, M, 3, A) [rad].
    """
    branches = {}
    for kind, of, name in (("then_branch", None, FREE_LOOP), ("else_branch", limits, LIMITED_LOOP)):
        inner = Builder(outer=g, prefix=f"{name}/")
        flights = _loop(inner, name, pilots, start, seen, seen_shape, lag, of)
        shapes = (pilots.dimension, "rows", pilots.number), ("steps", pilots.dimension, N_FLOWN, pilots.number)
        branches[kind] = inner.body(name, [], [value(of, shape) for of, shape in zip(flights, shapes, strict=True)])
    end, flown = g.ops("If", limits.free, names=["linear_end", "flown"], **branches)
    before = g.slice(flown, 2, 0, N_IDENTIFIED, name="before")
    last = g.op("MatMul", step.state, g.slice(end, 1, pilots.own, pilots.own + ACTING))
    after = g.op("Concat", g.slice(before, 0, 1), g.op("Unsqueeze", last, g.integers(0)), axis=0, name="after")
    return before, after, g.slice(flown, 2, N_IDENTIFIED, name="moved")


def _loop(
    g: Builder, name: str, pilots: Pilots, start: str, seen: str, seen_shape: Shape, lag: int, limits: Limits | None
) -> list[str]:
    """Add a loop whose commands act as given, or within limits; return its last state and what is kept of all steps."""
    b = Builder(outer=g, prefix=f"{name}/step/")
    waiting = _rows_waiting(g, lag)
    acting = pilots.own + ACTING
    parts = ["flown", "base", "rates", "arguments"]
    observed = ["observed", *(f"observed_{i}" for i in range(1, len(pilots.heights)))]
    heights = pilots.heights
    if limits:
        observed, heights = [*observed, "most", "least"], (*heights, N_ACTION, N_ACTION)

    def split(rows: str, names: list[str], heights: tuple[int, ...]) -> list[str]:
        return b.ops("Split", rows, b.integers(*heights), names=names, axis=1) if len(names) > 1 else [rows]

    def whole(matrix: str) -> str:
        wide = _widened(g, matrix, waiting)
        return limits.reached(g, wide, pilots.own, waiting, lag) if limits else wide

    def act(*rows: str) -> tuple[list[str], str]:
        if not limits:
            return pilots.act(b, *rows)
        own, command = pilots.act(b, *rows[:-2])
        return own, limits.limited(b, command, *rows[-2:])

    if lag:  # what acts now was sent before: one product gives the move and what the pilots see
        both = g.op("Concat", pilots.moves, pilots.sees, axis=1, name="step_map")
        rows = b.op("MatMul", whole(both), _LINEAR)
        flown, base, rates, arguments, *of_pilots = split(rows, parts + observed, (*MOVES, *heights))
        moved = [base, products(b, rates, arguments), b.slice(_LINEAR, 1, acting)]
        own, command = act(*of_pilots)
        following = [*own, *moved, command]
    else:
        sees = whole(g.slice(pilots.sees, 2, 0, acting))
        own, command = act(*split(b.op("MatMul", sees, _LINEAR), observed, heights))
        queue = b.op("Concat", _LINEAR, command, axis=1)
        flown, base, rates, arguments = split(b.op("MatMul", _widened(g, pilots.moves, waiting), queue), parts, MOVES)
        following = [*own, base, products(b, rates, arguments), b.slice(queue, 1, acting)]
    linear_next = b.op("Concat", *following, axis=1, name="linear_next")

    shape = (pilots.dimension, "rows", pilots.number)
    body = b.body(
        f"{name}.step",
        [value(_LINEAR, shape), value(SCAN_INPUT, seen_shape)],
        [value(linear_next, shape), value(flown, (pilots.dimension, N_FLOWN, pilots.number))],
    )
    return g.ops("Scan", start, seen, names=["linear_end", "flown"], body=body, num_scan_inputs=1)


def bodies(model: onnx.ModelProto) -> dict[str, onnx.GraphProto]:
    """Return what is done each step in the loops of an imagination, :data:`FREE_LOOP` and :data:`LIMITED_LOOP`."""
    branches = (a.g for node in model.graph.node if node.op_type == "If" for a in node.attribute)
    scans = ((branch.name, node) for branch in branches for node in branch.node if node.op_type == "Scan")
    return {name: a.g for name, scan in scans for a in scan.attribute if a.name == "body"}


def inputs(lag: int) -> list[onnx.ValueInfoProto]:
    """Return the declarations of the inputs that every imagination has."""
    return [
        value("x", (N_IDENTIFIED,)),
        value("dx", (N_IDENTIFIED,)),
        value("commands", (lag + 1 + MAX_DELAY, N_ACTION)),
        value("delay", (), onnx.TensorProto.INT64),
        value("model", ("models", N_REGRESSORS, N_IDENTIFIED)),
        value("exact_kinematics", (), onnx.TensorProto.BOOL),
        value("actuators", (N_ACTUATOR, N_ACTION)),
        value("reference", ("samples", N_REFERENCE)),
    ]
