"""The imagination of classical laws as one ONNX graph: what :mod:`task.laws` defines, flown by :mod:`export.loop`.

``export.rollout.rollout_laws`` is the same in plain numpy, and its reference. Q laws in M models are M Q models with
one pilot each. Ahead of L of :mod:`export.stepping` a state holds what is the law's own,

    c (8), reference (3), d(reference)/dt (3)

so that one product of the state gives the move and [v; c']. The graph depends on the command lag, and on nothing else
of a population.
"""

from __future__ import annotations

import numpy as np
import onnx

from export.builder import Builder, value
from export.limiting import Limits
from export.loop import SCAN_INPUT, Pilots, first_rows, fly, inputs
from export.scoring import SCORES, scores
from export.stepping import ACTED, N_LINEAR, ONE, Step
from task.laws import N_MEMORY, N_SEEN, READ, SEEN
from task.limits import DEFLECTION_LIMIT, DT
from task.state import N_ACTION, N_REFERENCE

N_GIVEN = 2 * N_REFERENCE
"""Reference and its rate: the end of y."""
N_OWN = N_MEMORY + N_GIVEN
N_LAW = N_ACTION + N_MEMORY
"""Rows of a law's maps."""


def law_imagination(lag: int) -> onnx.ModelProto:
    """Return the rollout of Q laws in M models as one graph.

    lag: samples between a command and the increment that it moves, beyond that of eq. 8.2. Inputs and outputs as in
    docs/architecture.md: ``x``, ``dx``, ``commands``, ``delay``, ``model``, ``exact_kinematics``, ``actuators``,
    ``reference``, ``maps`` (Q, 11, 38), ``memory`` (Q, 8) -> ``returns``, ``unsafe`` and ``travel``, (M, Q) each.
    """
    g = Builder()
    step = Step(g, np.ones(N_ACTION))
    models = g.slice(g.op("Shape", "model"), 0, 0, 1, name="models")
    laws = g.slice(g.op("Shape", "maps"), 0, 0, 1, name="laws")

    def paired(of: str, axis: int, name: str) -> str:
        """Add what each model (axis 1) or each law (axis 0) has, for every pair of both: (M Q, ...)."""
        shape = g.slice(g.op("Shape", of), 0, 1)
        every = g.op("Concat", models, laws, shape, axis=0)
        pairs = g.op("Expand", g.op("Unsqueeze", of, g.integers(axis)), every)
        return g.op("Reshape", pairs, g.op("Concat", g.integers(-1), shape, axis=0), name=name)

    moves = g.op("Pad", step.moves, g.integers(0, 0, N_OWN, 0, 0, 0), name="moves_of_all")
    given = _given(g)
    limits = Limits(g, np.zeros(N_ACTION), np.ones(N_ACTION))
    common = first_rows(g, limits, lag)
    begin = g.op("Concat", g.op("Reshape", g.slice(given, 0, 0, 1), g.integers(-1)), common, axis=0)
    every = g.op("Concat", laws, g.op("Shape", begin), axis=0)
    rows = g.op("Concat", "memory", g.op("Expand", begin, every), axis=1)
    start = g.op("Unsqueeze", paired(rows, 0, "rows_of_pairs"), g.integers(2), name="linear_start")
    # the state that a step leaves holds the reference of the next; behind the last there is none
    coming = g.op("Concat", g.slice(given, 0, 1), g.slice(given, 0, -1), axis=0)
    count = g.op("Mul", models, laws)
    every = g.op("Concat", g.slice(g.op("Shape", given), 0, 0, 1), count, g.integers(N_GIVEN, 1), axis=0)
    seen = g.op("Expand", g.op("Unsqueeze", coming, g.integers(1, 3)), every, name="given_of_pairs")

    def act(b: Builder, v: str, memory: str) -> tuple[list[str], str]:
        low, high = (b.constant(np.array(limit), "limit") for limit in (-DEFLECTION_LIMIT, DEFLECTION_LIMIT))
        return [memory, SCAN_INPUT], b.op("Clip", v, low, high, name="command")

    pilots = Pilots(
        paired(moves, 1, "moves_of_pairs"),
        paired(_sees(g, step), 0, "laws_of_pairs"),
        heights=(N_ACTION, N_MEMORY),
        own=N_OWN,
        act=act,
        number=1,
        dimension="pairs",
    )
    before, after, moved = fly(g, pilots, step, limits, start, seen, ("pairs", N_GIVEN, 1), lag)
    following = g.slice("reference", 0, 1, name="reference_next")
    shape = g.op("Concat", models, laws, axis=0)
    for name, of in zip(SCORES, scores(g, before, after, moved, following), strict=True):
        g.result(g.op("Reshape", of, shape), name)
    return g.model(
        "laws",
        [
            *inputs(lag),
            value("maps", ("laws", N_LAW, N_MEMORY + N_SEEN)),
            value("memory", ("laws", N_MEMORY)),
        ],
        [value(name, ("models", "laws")) for name in SCORES],
        "Predicted return, unsafe samples and surface travel of linear laws with memory and limits, in each model.",
    )


def _given(g: Builder) -> str:
    """Add reference and rate at every sample that a law acts on, (H, 6): ``task.laws.reference_rates``."""
    now = g.slice("reference", 0, 0, -1)
    steps = g.op("Sub", g.slice("reference", 0, 1), now)
    backward = g.op("Concat", g.slice(steps, 0, 0, 1), g.slice(steps, 0, 0, -1), axis=0)
    rates = g.op("Div", backward, g.constant(np.array(DT), "dt"))
    return g.op("Concat", now, rates, axis=1, name="given")


def _sees(g: Builder, step: Step) -> str:
    """Add the laws' maps of their own rows and L, (Q, 11, 14 + 33)."""
    of_memory = g.slice("maps", 2, 0, N_MEMORY)
    of_given = g.slice("maps", 2, N_MEMORY + SEEN.reference.start)
    rest = g.slice("maps", 2, N_MEMORY, N_MEMORY + SEEN.reference.start)
    one, acted = np.eye(1, N_LINEAR, k=ONE), np.eye(N_ACTION, N_LINEAR, k=ACTED)
    of_linear = g.op("Concat", g.constant(one, "one_of"), step.x_and_dx, g.constant(acted, "acted_of"), axis=0)
    read = g.op("Mul", of_linear, g.constant(READ[: SEEN.reference.start, None], "read"), name="y_of")
    return g.op("Concat", of_memory, of_given, g.op("MatMul", rest, read), axis=2, name="law_maps")
