"""What one imagination of the whole cast costs: our graph, batched numpy, and what the arithmetic alone would take.

``python -m bench.imagination`` measures all of them in turns within one run, on one thread, and writes
``results/imagination.json``. ``--before REVISION`` measures the graph that ``export/imagination.py`` of that revision
built beside today's; 70988a9 is the last one without delay and models.

Predicted before the first measurement, for networks of the thesis's shape: the graph is 3 to 6 times as fast as batched
numpy; it stays 5 to 15 times above the limit of its arithmetic, because a product of one row per actor cannot reuse a
weight; and it is 2 to 4 times above one matrix-vector product over all weights a step, which has to read the same
weights but pays for no other node. The wider the network, the nearer to that limit.

Found: 3.5 to 7 times as fast as numpy; against arithmetic and weights the prediction holds for casts of the thesis's
shape, small ones stay further above both. There it is not the nodes alone that are paid for, as was believed at first:
a product of one row with one actor's weights costs 0.2 to 0.3 us whatever its size, so that layers times actors count.
Halving the nodes of the loop therefore saves a third of a small cast's time, not half, and nothing of 50 wide members'.
Limits of range and rate cost a small cast about a fifth more, a large one a twentieth, for four nodes and six rows of
the product; healthy surfaces pay none of it, because they fly in a loop of their own.
Late commands cost a small cast up to a quarter more, a large one nothing to speak of. Several models at once cost less
than one after the other, because their rows share an actor's weights; the smaller the cast, the less they cost.
"""

from __future__ import annotations

import itertools
import subprocess
import time
import types
from collections.abc import Callable
from typing import NamedTuple

import click
import numpy as np
import onnxruntime

from bench import imagination_laws
from export.imagination import imagination
from export.network import Layer, Network, n_parameters, unflatten
from export.rollout import MAX_DELAY, rollout
from runtime.population import make_session
from task.actuators import HEALTHY
from task.errors import UserError
from task.model import DYNAMIC, embed_reduced
from task.reference import base_reference
from task.results import Claim, Result, Table, write
from task.state import STATE
from understudy import run

SEED = 0
LAG = 1
SQUARE = 512
"""Side of the matrices whose product shows what this core can do [elements]."""
MODELS = (3, 8)
"""Models imagined at once."""


class Case(NamedTuple):
    """A cast and how far it is imagined."""

    members: int
    width: int
    horizon: int
    shape: str = "thesis"
    """``thesis``: Linear, three times Linear with LayerNorm, Linear; ``small``: two hidden layers without; ``law``: the
    output layer alone; all with tanh."""

    @property
    def label(self) -> str:
        """Return the case in words."""
        return f"{self.shape}, {self.members} + 1 actors, {self.width} wide, {self.horizon} steps"

    @property
    def network(self) -> Network:
        """Return the actors' network."""
        plain, normalised = Layer(units=self.width), Layer(units=self.width, layer_norm="standard")
        hidden = {"thesis": (plain, *[normalised] * 3), "small": (plain, plain), "law": ()}[self.shape]
        return Network(layers=(*hidden, Layer(units=3)))


CASES = (
    Case(24, 3, 400, "law"),
    Case(8, 32, 400, "small"), Case(17, 32, 400, "small"), Case(50, 32, 400, "small"),
    Case(10, 72, 400), Case(17, 72, 400), Case(50, 32, 200), Case(50, 72, 200),
)  # fmt: skip


def flop(case: Case) -> int:
    """Return the multiplications and additions of the policies' products; all else is small beside them."""
    widths = [7, *(layer.units for layer in case.network.layers)]
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
    commands = np.zeros((LAG + 1 + MAX_DELAY, 3))
    arrays = (x, np.zeros(10), commands, embed_reduced(reduced), base_reference(20.0, 0.0)[: horizon + 1])
    return Inputs(*(a.astype(np.float32) for a in arrays))


def builder_of(revision: str) -> Callable[..., object]:
    """Return the function that built the graph at a revision of this repository; it must run with today's modules."""
    where = f"{revision}:export/imagination.py"
    shown = subprocess.run(["git", "show", where], capture_output=True, text=True, check=False)
    if shown.returncode:
        raise UserError(f"--before {revision}: git show {where}: {shown.stderr.strip().splitlines()[0]}")
    module = types.ModuleType("before")
    try:
        exec(compile(shown.stdout, where, "exec"), module.__dict__)
    except ImportError as error:
        raise UserError(f"--before {revision}: needs modules of its time: {error}; give a younger one") from None
    return module.imagination


def played(
    session: onnxruntime.InferenceSession, asked: Inputs, incumbent: np.ndarray, delay: int, models: int,
    actuators: np.ndarray,
) -> dict:  # fmt: skip
    """Return the feeds of a graph; one of before the delay takes the latest commands and one model."""
    feeds = {**asked._asdict(), "exact_kinematics": np.array(True), "incumbent": incumbent}
    names = {i.name for i in session.get_inputs()}
    if "actuators" in names:
        feeds["actuators"] = actuators.astype(np.float32)
    if "delay" in names:
        return feeds | {"delay": np.array(delay), "model": np.repeat(asked.model[None], models, axis=0)}
    return feeds | {"commands": asked.commands[MAX_DELAY:]}


def variants(case: Case, before: Callable[..., object] | None) -> dict[str, Callable[[], object]]:
    """Return what is measured, by name; each is one imagination of the case."""
    shape = case.network
    rng = np.random.default_rng(SEED)
    parameters = (0.1 * rng.normal(size=(case.members, n_parameters(shape)))).astype(np.float32)
    asked = question(case.horizon)

    def play(
        build: Callable[..., object], delay: int = 0, models: int = 1, actuators: np.ndarray = HEALTHY
    ) -> Callable[[], object]:
        session = make_session(build(shape, parameters, LAG).SerializeToString(), "imagination")  # type: ignore[attr-defined]
        feeds = played(session, asked, parameters[0], delay, models, actuators)
        return lambda: session.run(None, feeds)

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

    return {
        "graph": play(imagination),
        "delay 20": play(imagination, delay=MAX_DELAY),
        **{f"{m} models": play(imagination, models=m) for m in MODELS},
        "limited": play(imagination, actuators=imagination_laws.LIMITED),
        **({"before": play(before)} if before else {}),
        "batched numpy": lambda: rollout(shape, actors, *asked[:3], 0, asked.model, True, asked.reference),
        "reading the weights": read_weights,
        "arithmetic": arithmetic(flop(case)),
    }


def arithmetic(operations: int) -> Callable[[], float]:
    """Return what tells how long so many operations take [s] at the speed of a product of two large matrices."""
    square = np.random.default_rng(SEED).normal(size=(SQUARE, SQUARE)).astype(np.float32)
    product = np.empty_like(square)
    blocks = operations / (2 * SQUARE**3)

    def seconds() -> float:
        start = time.perf_counter()
        np.dot(square, square, out=product)
        return blocks * (time.perf_counter() - start)

    return seconds


def measure(timed: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the median time of each variant [ms], taken in turns."""
    samples: dict[str, list[float]] = {name: [] for name in timed}
    for turn in range(rounds + 1):
        for name, play in timed.items():
            start = time.perf_counter()
            own = play()
            took = own if isinstance(own, float) else time.perf_counter() - start
            if turn:  # the first turn warms up
                samples[name].append(1e3 * took)
    return {name: float(np.median(s)) for name, s in samples.items()}


def claims_of(label: str, ms: dict[str, float]) -> list[Claim]:
    """Return what a case says of the graph."""
    graph = ms["graph"]
    faster, late = ms["batched numpy"] / graph, ms["delay 20"] / graph
    claims = [
        Claim(claim=f"graph against batched numpy, {label}", value=round(faster, 2), unit="times as fast",
              target="> 1", holds=faster > 1.0),
        Claim(claim=f"graph against the limit of its arithmetic, {label}",
              value=round(graph / ms["arithmetic"], 1), unit="times as long"),
        Claim(claim=f"commands 20 samples late, {label}", value=round(late, 2), unit="times as long"),
        Claim(claim=f"three models at once, {label}", value=round(ms["3 models"] / graph, 2), unit="times as long",
              target="< 3", holds=ms["3 models"] < 3.0 * graph),
        Claim(claim=f"surfaces limited, {label}", value=round(ms["limited"] / graph, 2), unit="times as long"),
    ]  # fmt: skip
    if "before" in ms:
        ratio = graph / ms["before"]
        claims.append(
            Claim(claim=f"graph against the one before, {label}", value=round(ratio, 2), unit="times as long",
                  target="<= 1.05", holds=ratio <= 1.05)
        )  # fmt: skip
    return claims


@click.command()
@click.option("--rounds", type=click.IntRange(1), default=9, show_default=True)
@click.option("--before", "revision", help="Also measure the graph that this git revision built.")
def main(rounds: int, revision: str | None) -> None:
    """Measure and write results/imagination.json."""
    began = time.perf_counter()
    before = builder_of(revision) if revision else None
    rows: list[list] = []
    claims: list[Claim] = []
    ms: dict[str, float] = {}
    for case in CASES:
        ms = measure(variants(case, before), rounds)
        rows.append([case.label, *(round(v, 2) for v in ms.values()), round(1e3 * ms["graph"] / case.horizon, 1)])
        claims += claims_of(case.label, ms)
        click.echo(f"{case.label:44}" + "".join(f"  {name} {value:.2f}" for name, value in ms.items()) + " ms")
    timed = imagination_laws.variants(question(imagination_laws.HORIZON)._asdict())
    of_laws = measure({**timed, "arithmetic": arithmetic(imagination_laws.flop())}, rounds)
    law_claims, law_table = imagination_laws.figures(of_laws)
    result = Result(
        title="One imagination of the whole cast",
        command="python -m bench.imagination" + (f" --before {revision}" if revision else ""),
        seconds=round(time.perf_counter() - began, 1),
        runs=rounds,
        seeds=[SEED],
        claims=claims + law_claims,
        tables=[
            Table(title="Median of one imagination, one thread",
                  columns=["case", *(f"{name} [ms]" for name in ms), "graph [us/step]"], rows=rows),
            law_table,
        ],
        notes=[
            "thesis: networks of the thesis's shape, layer norm included; small: 7-32-32-3; law: 7-3.",
            "Variants in turns within one run: compare ratios.",
            "3 and 8 models: the whole cast in each of them, in one call.",
            "Reading the weights: one matrix-vector product over all actors' weights per layer and step.",
            f"Arithmetic: the products' operations at the speed of a {SQUARE} x {SQUARE} product on the same core.",
            "Limited: every surface with a range and a rate of its own, which a loop of its own flies.",
            "Laws: linear controllers with integrals; dispatch: its loop's nodes, each at the cost of adding three "
            "numbers.",
            *([f"Before: the graph of revision {revision}, without delay and with one model."] if revision else []),
        ],
    )  # fmt: skip
    click.echo(str(write("imagination", result)))


if __name__ == "__main__":
    run(main)
