"""What one imagination of the whole cast costs: our graph, batched numpy, and what the arithmetic alone would take.

``python -m bench.imagination`` measures all of them in turns within one run, on one thread, and writes
``results/imagination.json``.

Predicted before the first measurement, for networks of the thesis's shape: the graph is 3 to 6 times as fast as batched
numpy; it stays 5 to 15 times above the limit of its arithmetic, because a product of one row per actor cannot reuse a
weight; and it is 2 to 4 times above one matrix-vector product over all weights a step, which has to read the same
weights but pays for no other node. The wider the network, the nearer to that limit.

Found: 3 to 5 times as fast as numpy and 2 to 4 times above reading the weights, as predicted. Against the arithmetic
the prediction holds for the large and wide cast only (7 to 9 times); small or narrow ones stand 15 to 25 times above
it: there the nodes' dispatch, about 60 a step, is what is paid for.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import NamedTuple

import click
import numpy as np

from export.imagination import imagination
from export.network import Layer, Network, n_parameters, unflatten
from export.rollout import rollout
from runtime.population import make_session
from task.model import DYNAMIC, embed_reduced
from task.reference import base_reference
from task.results import Claim, Result, Table, write
from task.state import STATE

SEED = 0
LAG = 1
SQUARE = 512
"""Side of the matrices whose product shows what this core can do [elements]."""


class Case(NamedTuple):
    """A cast and how far it is imagined."""

    members: int
    width: int
    horizon: int


CASES = (Case(10, 72, 200), Case(10, 72, 400), Case(50, 32, 200), Case(50, 72, 200), Case(50, 72, 400))


def network(width: int) -> Network:
    """Return the thesis's shape: Linear, tanh, three times Linear, LayerNorm, tanh, and Linear, tanh."""
    hidden = (Layer(units=width), *[Layer(units=width, layer_norm="standard")] * 3)
    return Network(layers=(*hidden, Layer(units=3)))


def flop(case: Case) -> int:
    """Return the multiplications and additions of the policies' products; all else is small beside them."""
    widths = [7, *[case.width] * 4, 3]
    one = sum(2 * a * b for a, b in itertools.pairwise(widths))
    return (case.members + 1) * case.horizon * one


class Inputs(NamedTuple):
    """One question to the imagination, in float32."""

    x: np.ndarray
    dx: np.ndarray
    commands: np.ndarray
    model: np.ndarray
    reference: np.ndarray


def question(horizon: int) -> Inputs:
    """Return a trimmed start, a model with damping and effectiveness of the usual size, and the base reference."""
    x = np.zeros(10)
    x[STATE.V], x[STATE.h], x[STATE.alpha], x[STATE.theta] = 90.0, 2000.0, 0.05, 0.0
    reduced = np.zeros((11, len(DYNAMIC)))
    reduced[: len(DYNAMIC)] = 0.98 * np.eye(len(DYNAMIC))
    reduced[8, STATE.q], reduced[9, STATE.p], reduced[10, STATE.r] = -0.12, -0.2, -0.04
    arrays = (x, np.zeros(10), np.zeros((LAG + 1, 3)), embed_reduced(reduced), base_reference(20.0, 0.0)[: horizon + 1])
    return Inputs(*(a.astype(np.float32) for a in arrays))


def variants(case: Case) -> dict[str, Callable[[], object]]:
    """Return what is measured, by name; each is one imagination of the case."""
    shape = network(case.width)
    rng = np.random.default_rng(SEED)
    parameters = (0.1 * rng.normal(size=(case.members, n_parameters(shape)))).astype(np.float32)
    asked = question(case.horizon)
    session = make_session(imagination(shape, parameters, LAG).SerializeToString(), "imagination")
    feeds = {**asked._asdict(), "exact_kinematics": np.array(True), "incumbent": parameters[0]}
    actors = np.concatenate([parameters, parameters[:1]])

    weights = [
        (t.reshape(-1, t.shape[-1]), np.ones(t.shape[-1], np.float32), np.empty(t.shape[0] * t.shape[1], np.float32))
        for name, t in unflatten(shape, actors).items()
        if name.endswith("weight")
    ]
    weights = [(np.ascontiguousarray(w), v, out) for w, v, out in weights]

    def read_weights() -> None:
        for _ in range(case.horizon):
            for matrix, vector, out in weights:
                np.dot(matrix, vector, out=out)

    square = rng.normal(size=(SQUARE, SQUARE)).astype(np.float32)
    product = np.empty_like(square)
    blocks = flop(case) / (2 * SQUARE**3)

    def arithmetic() -> float:
        start = time.perf_counter()
        np.dot(square, square, out=product)
        return blocks * (time.perf_counter() - start)

    return {
        "graph": lambda: session.run(None, feeds),
        "batched numpy": lambda: rollout(shape, actors, *asked[:4], True, asked.reference),
        "reading the weights": read_weights,
        "arithmetic": arithmetic,
    }


def measure(case: Case, rounds: int) -> dict[str, float]:
    """Return the median time of each variant [ms], taken in turns."""
    timed = variants(case)
    samples: dict[str, list[float]] = {name: [] for name in timed}
    for turn in range(rounds + 1):
        for name, play in timed.items():
            start = time.perf_counter()
            own = play()
            took = own if isinstance(own, float) else time.perf_counter() - start
            if turn:  # the first turn warms up
                samples[name].append(1e3 * took)
    return {name: float(np.median(s)) for name, s in samples.items()}


@click.command()
@click.option("--rounds", default=9, show_default=True)
def main(rounds: int) -> None:
    """Measure and write results/imagination.json."""
    began = time.perf_counter()
    rows: list[list] = []
    claims = []
    for case in CASES:
        ms = measure(case, rounds)
        label = f"{case.members} + 1 actors, {case.width} wide, {case.horizon} steps"
        graph = ms["graph"]
        rows.append([label, *(round(v, 2) for v in ms.values()), round(1e6 * graph / (case.horizon * 1e3), 1)])
        faster = ms["batched numpy"] / graph
        claims.append(
            Claim(claim=f"graph against batched numpy, {label}", value=round(faster, 2), unit="times as fast",
                  target="> 1", holds=faster > 1.0)
        )  # fmt: skip
        claims.append(
            Claim(claim=f"graph against the limit of its arithmetic, {label}",
                  value=round(graph / ms["arithmetic"], 1), unit="times as long")
        )  # fmt: skip
        print(f"{label:38}" + "".join(f"  {name} {value:7.2f} ms" for name, value in ms.items()))
    columns = [
        "case",
        "graph [ms]",
        "batched numpy [ms]",
        "reading the weights [ms]",
        "arithmetic [ms]",
        "graph [us/step]",
    ]
    result = Result(
        title="One imagination of the whole cast",
        command="python -m bench.imagination",
        seconds=round(time.perf_counter() - began, 1),
        runs=rounds,
        seeds=[SEED],
        claims=claims,
        tables=[Table(title="Median of one imagination, one thread", columns=columns, rows=rows)],
        notes=[
            "Networks of the thesis's shape, layer norm included; variants in turns within one run: compare ratios.",
            "Reading the weights: one matrix-vector product over all actors' weights per layer and step.",
            f"Arithmetic: the products' operations at the speed of a {SQUARE} x {SQUARE} product on the same core.",
        ],
    )
    print(write("imagination", result))


if __name__ == "__main__":
    main()
