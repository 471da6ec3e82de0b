"""What one imagination of classical laws costs: the graph, batched numpy, and what dispatch and arithmetic alone take.

A part of ``python -m bench.imagination``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from export.builder import Builder, value
from export.law_imagination import law_imagination
from export.loop import FREE_LOOP, bodies
from export.rollout import MAX_DELAY, rollout_laws
from export.stepping import MOVES, N_LINEAR
from runtime.population import make_session
from task.actuators import HEALTHY
from task.laws import N_MEMORY, N_SEEN, SEEN
from task.results import Claim, Table
from task.state import N_ACTION, TRACKED

LAWS = 2
HORIZON = 400
MODELS = 3
LIMITED = np.array([[-0.1, -0.05, -0.1], [0.1, 0.05, 0.1], [0.5, 0.5, 0.5]])
"""Actuators (3, 3) whose range and rate are limited, rows of ``task.actuators.ACTUATOR``."""
CHAIN = (2, 22)
"""Nodes of the loops whose difference shows what a node costs."""


def laws(count: int) -> np.ndarray:
    """Return maps (count, 11, 38) of attitude feedback with integrals, each a little harder than the one before."""
    maps = np.zeros((count, N_ACTION + N_MEMORY, N_MEMORY + N_SEEN), dtype=np.float32)
    y = maps[:, :, N_MEMORY:]
    gains = np.diag([-1.0, -0.5, 0.5]) * (1.0 + 0.1 * np.arange(count)[:, None, None])
    y[:, :N_ACTION, SEEN.reference] = gains
    y[:, :N_ACTION, SEEN.x][:, :, TRACKED] = -gains
    maps[:, N_ACTION:, :N_MEMORY] = np.eye(N_MEMORY)
    y[:, N_ACTION : 2 * N_ACTION, SEEN.reference] = 0.01 * np.eye(N_ACTION)
    maps[:, :N_ACTION, :N_ACTION] = 0.2 * gains
    return maps


def loop_nodes() -> int:
    """Return the number of nodes within the graph's loop, surfaces healthy."""
    return len(bodies(law_imagination(1))[FREE_LOOP].node)


def chain(nodes: int, steps: int) -> Callable[[], object]:
    """Return a loop of so many sums of three numbers: all that it costs is dispatch."""
    g = Builder()
    b = Builder(outer=g, prefix="step/")
    last = "step/sum"
    for _ in range(nodes):
        last = b.op("Add", last, "step/term")
    body = b.body("step", [value("step/sum", (3,)), value("step/term", (3,))], [value(last, (3,))])
    g.result(g.op("Scan", "start", "terms", body=body, num_scan_inputs=1), "end")
    model = g.model("chain", [value("start", (3,)), value("terms", (steps, 3))], [value("end", (3,))])
    session = make_session(model.SerializeToString(), "chain")
    feeds = {"start": np.zeros(3, dtype=np.float32), "terms": np.zeros((steps, 3), dtype=np.float32)}
    return lambda: session.run(None, feeds)


def flop() -> int:
    """Return the multiplications and additions of the loop's product; all else is small beside it."""
    rows = sum(MOVES) + N_ACTION + N_MEMORY
    return LAWS * HORIZON * 2 * rows * (N_LINEAR + N_MEMORY + 2 * N_ACTION)


def variants(asked: dict[str, np.ndarray]) -> dict[str, Callable[[], object]]:
    """Return what is measured, by name; asked: ``x``, ``dx``, ``commands``, ``model``, ``reference`` of a question."""
    maps, memory = laws(LAWS), np.zeros((LAWS, N_MEMORY), dtype=np.float32)
    session = make_session(law_imagination(1).SerializeToString(), "laws")

    def play(delay: int, models: int, actuators: np.ndarray = HEALTHY) -> Callable[[], object]:
        feeds = asked | {
            "delay": np.array(delay), "exact_kinematics": np.array(True), "maps": maps, "memory": memory,
            "model": np.repeat(asked["model"][None], models, axis=0), "actuators": actuators.astype(np.float32),
        }  # fmt: skip
        return lambda: session.run(None, feeds)

    start = asked["x"], asked["dx"], asked["commands"]
    return {
        "graph": play(0, 1),
        "delay 20": play(MAX_DELAY, 1),
        f"{MODELS} models": play(0, MODELS),
        "limited": play(0, 1, LIMITED),
        "batched numpy": lambda: rollout_laws(maps, memory, *start, 0, asked["model"], True, asked["reference"]),
        "short chain": chain(CHAIN[0], HORIZON),
        "long chain": chain(CHAIN[1], HORIZON),
    }


def figures(ms: dict[str, float]) -> tuple[list[Claim], Table]:
    """Return what the medians [ms] of :func:`variants` and of ``arithmetic`` say."""
    ms = dict(ms)
    dispatch = loop_nodes() * (ms.pop("long chain") - ms.pop("short chain")) / (CHAIN[1] - CHAIN[0])
    ms["dispatch"] = dispatch
    graph, label = ms["graph"], f"{LAWS} laws, {HORIZON} steps"
    faster = ms["batched numpy"] / graph
    claims = [
        Claim(claim=f"graph against batched numpy, {label}", value=round(faster, 2), unit="times as fast",
              target="> 1", holds=faster > 1.0),
        Claim(claim=f"graph against the dispatch of its loop's nodes, {label}", value=round(graph / dispatch, 2),
              unit="times as long"),
        Claim(claim=f"{MODELS} models at once, {label}", value=round(ms[f"{MODELS} models"] / graph, 2),
              unit="times as long", target=f"< {MODELS}", holds=ms[f"{MODELS} models"] < MODELS * graph),
        Claim(claim=f"surfaces limited, {label}", value=round(ms["limited"] / graph, 2), unit="times as long"),
    ]  # fmt: skip
    table = Table(
        title="Median of one imagination of classical laws, one thread",
        columns=["case", *(f"{name} [ms]" for name in ms), "graph [us/step]"],
        rows=[[label, *(round(v, 3 if v < 0.1 else 2) for v in ms.values()), round(1e3 * graph / HORIZON, 1)]],
    )
    return claims, table
