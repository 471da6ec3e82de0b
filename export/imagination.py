"""The imagination of a whole population as one ONNX graph (thesis eqs 8.2, 11, 12).

``export.rollout.rollout`` is the same in plain numpy, and its reference. The loop is that of :mod:`export.loop`; all
policies are one product a layer (:mod:`export.actors`).
"""

from __future__ import annotations

import numpy as np
import onnx

from export.actors import Actors
from export.builder import Builder, value
from export.limiting import Limits
from export.loop import SCAN_INPUT, Pilots, first_rows, fly, inputs
from export.network import Network
from export.scoring import SCORES, scores
from export.stepping import N_LINEAR, Step, observed_reference, observed_state
from task.state import N_ACTION, N_OBSERVATION


def imagination(network: Network, parameters: np.ndarray, lag: int) -> onnx.ModelProto:
    """Return the rollout of all members and of the incumbent, in M models, as one graph.

    parameters: (P, K) float32, the members; lag: samples between a command and the increment that it moves, beyond
    that of eq. 8.2. Inputs and outputs as in docs/architecture.md: ``x``, ``dx``, ``commands``, ``delay``, ``model``,
    ``exact_kinematics``, ``actuators``, ``reference``, ``incumbent`` -> ``returns``, ``unsafe`` and ``travel``,
    (M, P + 1) each.
    """
    count = parameters.shape[0] + 1
    g = Builder()
    actors = Actors(g, network, parameters)
    step = Step(g, actors.unit)
    observed = observed_state(g, step, network)
    now = g.slice("reference", 0, 0, -1, name="reference_now")
    following = g.slice("reference", 0, 1, name="reference_next")
    seen = observed_reference(g, now, network)
    limits = Limits(g, actors.offset, actors.unit)
    rows = first_rows(g, limits, lag)
    models = g.slice(g.op("Shape", "model"), 0, 0, 1)
    shape = g.op("Concat", models, g.op("Shape", rows), g.integers(count), axis=0)
    start = g.op("Expand", g.op("Unsqueeze", rows, g.integers(0, 2)), shape, name="linear_start")

    def act(b: Builder, observed: str) -> tuple[list[str], str]:
        s = b.op("Add", observed, SCAN_INPUT, name="s")
        return [], actors.act(b, b.op("Transpose", s, perm=[2, 0, 1], name="s_rows"))

    seen_rows = N_OBSERVATION + 1
    pilots = Pilots(step.moves, _per_model(g, step, observed), (seen_rows,), 0, act, count)
    before, after, moved = fly(g, pilots, step, limits, start, seen, (seen_rows, 1), lag)
    for name, of in zip(SCORES, scores(g, before, after, moved, following), strict=True):
        g.result(of, name)
    return g.model(
        "imagination",
        [*inputs(lag), value("incumbent", (parameters.shape[1],))],
        [value(name, ("models", count)) for name in SCORES],
        "Predicted return, unsafe samples and surface travel of every member and, last, the incumbent, in each model.",
    )


def _per_model(g: Builder, step: Step, observed: str) -> str:
    """Return the observations' map for each model, and for the command that acts now: (M, 8, 33)."""
    wide = g.op("Concat", observed, g.constant(np.zeros((N_OBSERVATION + 1, N_ACTION)), "not_yet"), axis=1)
    shape = g.op("Shape", step.moves)
    models = g.slice(shape, 0, 0, 1)
    return g.op("Expand", wide, g.op("Concat", models, g.integers(N_OBSERVATION + 1, N_LINEAR), axis=0))
