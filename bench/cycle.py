"""What each piece of the cycle costs, beside what a peer takes for the same.

``python -m bench.cycle --population populations/serl50`` times every piece and its peer in turns within one run, so
that the ratios mean something on a noisy machine, and writes ``results/cycle.json``.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from filterpy.kalman import KalmanFilter
from msgspec.structs import replace
from pymavlink.dialects.v20 import common as mavlink

from runtime import codec
from runtime.clock import SteppedClock
from runtime.continuity import Continuity
from runtime.excitation import Excitation
from runtime.guard import Guard, Health
from runtime.identification import IncrementalModel, RecursiveLeastSquares
from runtime.imagination import Imagination
from runtime.link import Sample
from runtime.loop import Loop
from runtime.plays import Plays
from runtime.population import BehaviouralPolicy, Population, load_population, make_session
from runtime.presets import resolve
from runtime.rate_filter import N, RateFilters
from runtime.recorder import Recorder
from runtime.reference import RecordedReference
from runtime.state_filter import StateFilter
from runtime.structured import Effectiveness
from runtime.switching import Action, Cast, Decision, Reason
from sim_bridge.codec import Codec
from task.errors import UserError
from task.limits import DEFLECTION_LIMIT, DT
from task.model import N_REGRESSORS, embed_reduced
from task.observation import observation
from task.rates import RATES
from task.results import Claim, Result, Table, write
from task.state import N_IDENTIFIED, N_OBSERVATION, STATE
from understudy import run

CALLS = 200
ROUNDS = 40
ACTION = np.array([-0.024, 0.001, 0.002])


class Piece(NamedTuple):
    """One piece of the cycle; ``peer`` is None for a piece that is timed for the sum alone."""

    name: str
    ours: Callable[[], object]
    peer: Callable[[], object] | None = None
    peer_name: str = ""


class SilentLink:
    """A link that takes commands and sends nothing: what is left is the cycle itself."""

    ended = ""
    skipped = repeated = 0

    def read(self, timeout: float) -> Sample | None:
        """Return None."""
        return None

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Do nothing."""

    def say(self, text: str, severity: int) -> None:
        """Do nothing."""

    def diagnosis(self) -> str:
        """Return nothing."""
        return ""

    def close(self) -> None:
        """Do nothing."""


def level() -> np.ndarray:
    """Return a state with numbers of the usual size."""
    x = np.full(len(STATE), 0.05)
    x[STATE.V], x[STATE.h], x[STATE.xe] = 90.0, 1990.0, 110.0
    return x


def wire() -> list[Piece]:
    """Return the two frames of a tick, by hand and through the generated classes."""
    data = bytearray(Codec(2000.0, 0).odometry(10_000, level()))
    odometry, controls, mav = codec.Odometry(), codec.Controls(1, 1, True), mavlink.MAVLink(None, 1, 1)

    def read() -> None:
        frame = codec.next_frame(data, 0, len(data))
        assert frame is not None
        codec.checksum_holds(data, frame, codec.ODOMETRY_EXTRA)
        odometry.read(data, frame, 2000.0)

    def theirs() -> bytes:
        scaled = [a / DEFLECTION_LIMIT for a in ACTION] + [0.0] * 13
        return mavlink.MAVLink_hil_actuator_controls_message(10_000, scaled, 128, 1).pack(mav)

    return [
        Piece("ODOMETRY to state", read, lambda: mavlink.MAVLink(None).decode(data), "pymavlink decode (no state yet)"),
        Piece("command to HIL_ACTUATOR_CONTROLS", lambda: controls.pack(0, 10_000, ACTION), theirs, "pymavlink pack"),
    ]


def learning() -> list[Piece]:
    """Return the recursion beside filterpy's Kalman filter, which takes one output at a time."""
    rng = np.random.default_rng(0)
    z, y = 1e-3 * rng.normal(size=N_REGRESSORS), 1e-3 * rng.normal(size=N_IDENTIFIED)
    rls = RecursiveLeastSquares(np.zeros((N_REGRESSORS, N_IDENTIFIED)), np.eye(N_REGRESSORS), 0.9995)
    oracle = KalmanFilter(dim_x=N_REGRESSORS, dim_z=1)
    oracle.Q, oracle.alpha, oracle.H = np.zeros((N_REGRESSORS,) * 2), 0.9995**-0.5, z[None, :]

    def theirs() -> None:
        oracle.predict()
        oracle.update(y[0])

    model = IncrementalModel(resolve("thesis").adaptation, 1)
    states = level()[None, :] + 1e-3 * rng.normal(size=(64, len(STATE)))
    count = iter(range(10**9))

    def whole() -> None:
        model.observe(states[next(count) % 64])
        model.command(ACTION)

    return [
        Piece("RLS, 13 regressors, 10 outputs", lambda: rls.update(z, y), theirs, "filterpy, 1 output of the 10"),
        Piece("increments, lag and RLS", whole),
    ]


def estimating(population: Population) -> list[Piece]:
    """Return the bank of Kalman filters beside one of filterpy's, and the estimator with fewer and more hypotheses."""
    settings, rates = resolve("structured").adaptation, population.rates
    if rates is None:
        raise UserError(f"{population.name}: expected a population with a rate model; export it again")
    rng = np.random.default_rng(0)
    states = level()[None, :] + 1e-3 * rng.normal(size=(64, len(STATE)))
    found = Effectiveness(settings, rates, population.command_lag)
    size = len(found.filter.s)
    bank, u, w = RateFilters(rates, size), np.tile(ACTION, (size, 1)), states[0, :3]
    bank.variances[:], bank.q[:], bank.r[:] = 1e-2, 1e-6, 1e-6
    listed = states[0].tolist()
    theirs = [KalmanFilter(dim_x=N, dim_z=len(w)) for _ in range(size)]
    for each in theirs:
        each.H, each.R, each.Q = np.eye(len(w), N), 1e-6 * np.eye(len(w)), 1e-6 * np.eye(N)

    def ours() -> None:
        bank.linearise(listed[:N_IDENTIFIED], 0.0, u)
        bank.predict()
        bank.update(w)

    def filterpy() -> None:
        for each in theirs:
            each.predict()
            each.update(w)

    def estimator(found: Effectiveness) -> Callable[[], None]:
        count = iter(range(10**9))

        def sample() -> None:
            found.observe(states[next(count) % 64])
            found.command(ACTION)

        return sample

    plain = Effectiveness(replace(settings, ranges=False), rates, population.command_lag)
    preset = resolve("ensemble").adaptation
    most, resting = (
        Effectiveness(each, rates, population.command_lag) for each in (preset, replace(preset, q_uncommanded=0.0))
    )
    return [
        Piece(f"{size} Kalman filters, 11 states", ours, filterpy, "filterpy, one by one"),
        Piece("signed effectiveness, all of it", estimator(found)),
        Piece("signed effectiveness, no ranges", estimator(plain)),
        Piece("signed effectiveness, as in ensemble: lag, uncommanded motion, gusts", estimator(most)),
        Piece("signed effectiveness, as in ensemble, no uncommanded motion", estimator(resting)),
    ]


def foretelling(population: Population) -> list[Piece]:
    """Return what late commands cost in each sample: the model where the aircraft flies, taken over the delay."""
    model = IncrementalModel(
        resolve("ensemble").adaptation, population.command_lag, population.theta, population.p0, DT, population.rates,
        population.max_delay, population.learnt_at,
    )  # fmt: skip
    found, x = model.effectiveness, level()
    assert found is not None
    for _ in range(10):
        model.observe(x)
        model.command(ACTION)
    model.observe(x)
    late = max(each.delay for each in found.hypotheses)
    found.evidence.believed = [each.delay for each in found.hypotheses].index(late)
    return [Piece(f"state foretold {late * DT:g} s ahead, where commands are late", lambda: model.answered(x))]


def reading(population: Population) -> list[Piece]:
    """Return what finds out whether a state can be used, and how noisy it is."""
    x, filtered, continuity, ticks = level(), StateFilter(population.learnt_at, DT), Continuity(), iter(range(10**9))
    assert population.theta is not None
    filtered.take(embed_reduced(population.theta))
    rates, states = np.zeros(RATES), (x.tolist(), (x + 1e-6).tolist())

    def follow() -> None:
        tick = next(ticks)
        continuity.broken(states[tick % 2], 10_000 * tick)

    return [
        Piece(
            "filter of speed, angles of attack, sideslip, bank, pitch", lambda: filtered.hear(x, rates, rates, ACTION)
        ),
        Piece("whether a state can follow the last", follow),
    ]


def acting(population: Population) -> list[Piece]:
    """Return the behavioural policy with bound memory beside a plain session call, and what surrounds it."""
    policy = BehaviouralPolicy(population)
    session = make_session(population.behaviour, "behaviour")
    x, s, reference = level(), np.zeros(N_OBSERVATION), np.zeros(3)
    feeds = {
        t.name: policy.parameters[t.offset : t.offset + t.size].reshape(t.shape) for t in population.manifest.parameters
    }
    guard = Guard(resolve().operation)
    cast = Cast(policy.parameters, population.parameters, population.champion, 0.05)
    last = len(population.members) - 1

    def blend() -> None:
        if cast.blend < 0.5:
            cast.take(Decision(Action.SOFT, last, Reason.BETTER, 1.0))
        cast.step()

    return [
        Piece("observation", lambda: observation(x, reference, s)),
        Piece(
            "behavioural policy, live parameters", lambda: policy.act(s),
            lambda: session.run(None, {"observation": s.astype(np.float32)[None, :], **feeds}), "session.run",
        ),
        Piece("one step of a blend (eq. 8.8)", blend),
        Piece("last gate, state and command", lambda: (guard.check_state(x), guard.command(ACTION))),
    ]  # fmt: skip


def whole(population: Population, folder: Path, imagination: Imagination) -> list[Piece]:
    """Return the log's share and the whole cycle, without a socket and without a play."""
    configuration = resolve("understudy", None, ("t_play=1e6",))
    x, reference = level(), np.zeros(3)
    onward = x.copy()  # a state that stands still is not flown
    onward[STATE.xe] += 1.0
    policy = BehaviouralPolicy(population)
    cast = Cast(policy.parameters, population.parameters, population.champion, 0.05)
    model = IncrementalModel(configuration.adaptation, population.command_lag, population.theta, population.p0)
    recorder = Recorder(folder / "bench.ulg", configuration, "bench", population.members, model.outputs, {})
    rows = RecordedReference(np.zeros((10, 3)))
    plays = Plays(imagination, model, cast, rows, configuration.adaptation, DT, True)
    loop = Loop(
        SilentLink(), SteppedClock(), policy, cast, model, plays, rows, Guard(configuration.operation), recorder,
        Excitation(configuration.adaptation, None), configuration.operation, population.members,
    )  # fmt: skip
    loop.begin(Sample(0, 1, x))
    ticks = iter(range(1, 10**9))
    innovation = np.zeros(len(model.outputs))

    def record() -> None:
        recorder.cycle(0, 0, x, ACTION, reference, 0.0, 0, Health.OK)
        recorder.innovation(0, innovation, 1.0)

    def cycle() -> None:
        tick = next(ticks)
        loop.cycle(Sample(10_000 * tick, 1, onward if tick % 2 else x))

    return [Piece("flight log", record), Piece("the whole cycle but the socket", cycle)]


def per_call(function: Callable[[], object]) -> float:
    """Return the mean time of a call [us]."""
    start = time.perf_counter_ns()
    for _ in range(CALLS):
        function()
    return 1e-3 * (time.perf_counter_ns() - start) / CALLS


def measure(pieces: list[Piece]) -> list[tuple[Piece, float, float | None]]:
    """Return for each piece the median time of a call and its peer's [us], all taken in turns."""
    times: dict[tuple[int, bool], list[float]] = {}
    for _ in range(ROUNDS):
        for number, piece in enumerate(pieces):
            times.setdefault((number, True), []).append(per_call(piece.ours))
            if piece.peer is not None:
                times.setdefault((number, False), []).append(per_call(piece.peer))
    return [
        (
            piece,
            statistics.median(times[number, True]),
            statistics.median(times[number, False]) if piece.peer is not None else None,
        )
        for number, piece in enumerate(pieces)
    ]


@click.command()
@click.option("--population", type=Path, default=Path("populations/serl50"), show_default=True)
@click.option("--out", type=Path, default=Path("results"), show_default=True, help="Folder of the result.")
def main(population: Path, out: Path) -> None:
    """Time the pieces of the cycle and write results/cycle.json."""
    began = time.perf_counter()
    cast = load_population(population)
    with tempfile.TemporaryDirectory() as folder, Imagination(cast, 1) as imagination:
        found = measure(
            [
                *wire(),
                *learning(),
                *estimating(cast),
                *foretelling(cast),
                *reading(cast),
                *acting(cast),
                *whole(cast, Path(folder), imagination),
            ]
        )
    rows = [
        [piece.name, round(ours, 1), piece.peer_name or None, round(peer, 1) if peer else None,
         round(peer / ours, 1) if peer else None]
        for piece, ours, peer in found
    ]  # fmt: skip
    for name, ours, peer_name, peer, ratio in rows:
        click.echo(f"{name:38} {ours:8.1f} us" + (f"   {peer_name}: {peer:.1f} us, {ratio} x" if peer_name else ""))
    cycle = rows[-1][1]
    claims = [
        Claim(claim=f"{piece.name}: times cheaper than {piece.peer_name}", value=round(peer / ours, 1), unit="x",
              target=">= 1", holds=peer >= ours)
        for piece, ours, peer in found if peer
    ]  # fmt: skip
    claims.append(
        Claim(claim="the whole cycle but the socket, median", value=cycle, unit="us",
              target="<= 1000, a tenth of a sample", holds=cycle <= 1000.0)
    )  # fmt: skip
    result = Result(
        title="Cost of the runtime's cycle",
        command=f"python -m bench.cycle --population {population}",
        seconds=round(time.perf_counter() - began, 1),
        runs=ROUNDS,
        seeds=[0],
        claims=claims,
        tables=[Table(title="Median time of a call", columns=["piece", "us", "peer", "us", "peer / ours"], rows=rows)],
        notes=["Pieces and peers are timed in turns in one process; the ratios carry over to other machines, the "
               "microseconds do not."],
    )  # fmt: skip
    write("cycle", result, out)


if __name__ == "__main__":
    run(main)
