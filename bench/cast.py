"""What the default cast covers: members, specialists, classical laws and single policies in easy and hard cases.

``python -m bench.cast`` flies the population on references and seeds that breeding has not seen, writes
``results/cast.json`` and the pictures of docs/cast.md. Every case measured is kept below ``--cache``, so that an
interrupted run goes on.
"""

from __future__ import annotations

import hashlib
import os
import time
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np

from bench.cast_tables import Cell, Measured, coverage_picture, result
from export.cast.cases import EASY, Case
from export.cast.config import CastSettings
from export.cast.flights import Flown, Stage, Trial
from export.network import Network
from runtime.laws.catalogue import LawName, load_settings, make_law
from task.config import Settings, convert, load_json, read_bytes, to_json
from task.errors import UserError
from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.reference import random_reference
from task.results import write
from task.state import N_REFERENCE, STATE
from understudy import run

PEERS: tuple[LawName, ...] = ("pid", "indi", "indi-rls-signfree")
PICTURE = Path("docs/img/cast_coverage.png")
SEED = 20_000_003
"""Of references, onsets and noise: of another stream than breeding and tuning."""


class Protocol(Settings, frozen=True):
    """How the tables are measured."""

    hard_references: int = 4
    hard_duration: float = 24.0
    """[s]"""
    onset: tuple[float, float] = (4.0, 10.0)
    """Earliest and latest onset of the faults [s]."""
    easy_references: int = 10
    easy_duration: float = 80.0
    """[s]"""


class Folder:
    """A population folder, as far as this bench reads it."""

    def __init__(self, path: Path) -> None:
        """Read it. Raises UserError when it is none."""
        manifest: dict[str, Any] = load_json(path / "manifest.json", dict, "manifest of a population")
        self.network = convert(manifest["network"], Network, str(path / "manifest.json"))
        self.parameters = np.load(path / "parameters.npy", allow_pickle=False)
        self.members = [member["name"] for member in manifest["members"]]
        self.scores: dict[str, dict[str, float]] = {m["name"]: m["scores"] for m in manifest["members"]}
        self.champion = self.members.index(manifest["champion"])
        self.training: dict[str, Any] = manifest["training"]
        self.sha256 = hashlib.sha256(read_bytes(path / "parameters.npy", "parameters")).hexdigest()


class Bench:
    """The cast, its specialists and its peers on one stage."""

    def __init__(self, cast: Folder, serl: Folder, protocol: Protocol) -> None:
        """Raises UserError for a population that ``export.cast`` did not make."""
        self.cast, self.serl, self.protocol = cast, serl, protocol
        training = cast.training
        if "bred" not in training:
            raise UserError("the population's manifest has no 'training.bred'; give one that 'export.cast' made")
        self.specialists = {bred["case"]: np.array(bred["parameters"]) for bred in training["bred"]}
        self.robust = np.array(training["single_robust_policy"])
        self.settings = convert(training["config"], CastSettings, "the population's training.config")
        self.for_case: dict[str, str] = training["chosen"]["for_case"]
        self.stage = Stage()

    def trials(self, case: Case, hard: bool) -> list[Trial]:
        """Return the trials of a case, the same for everybody."""
        p, rng = self.protocol, np.random.default_rng([SEED, zlib.crc32(case.name.encode())])
        self.stage.plant.reset(case.condition)
        theta = float(self.stage.plant.trim.x[STATE.theta])
        drawn = []
        for _ in range(p.hard_references if hard else p.easy_references):
            reference = random_reference(rng, p.hard_duration if hard else p.easy_duration, theta)
            onset = round(float(rng.uniform(*p.onset)), 2) if hard else 0.0
            decision = self.settings.trial.decision if hard else 0.0
            drawn.append(Trial(case, reference, onset, onset + decision, int(rng.integers(2**31))))
        return drawn

    def measure(self, case: Case, hard: bool) -> Measured:
        """Fly everybody who has a place in the case's table."""
        trials = self.trials(case, hard)
        champion = self.cast.parameters[self.cast.champion]
        chosen = self.for_case[case.name]
        names = self.cast.members if hard else list(dict.fromkeys([self.cast.members[self.cast.champion], chosen]))
        pilots = {name: self.cast.parameters[self.cast.members.index(name)] for name in names}
        specialist = self.specialists.get(case.name)
        if specialist is not None and case.name not in names:
            pilots["specialist"] = specialist
        flown = self.stage.fly(self.cast.network, np.array(list(pilots.values())), trials, champion if hard else None)
        cells = dict(zip(pilots, cells_of(flown, trials), strict=True))
        alone = self.stage.fly(self.cast.network, self.robust[None], trials)
        cells["robust"] = cells_of(alone, trials)[0]
        if specialist is not None and case.name in names:
            cells["specialist"] = cells[case.name]
        if hard:
            serl = self.stage.fly(self.serl.network, self.serl.parameters[self.serl.champion][None], trials)
            cells["serl"] = cells_of(serl, trials)[0]
            laws = self.stage.fly_pilots([LawPilot(law) for law in PEERS], trials)
            cells.update(zip(PEERS, cells_of(laws, trials), strict=True))
        members = {name: cells.pop(name) for name in names}
        return Measured(case=case.name, hard=hard, chosen=chosen, members=members, others=cells)


class LawPilot:
    """A classical law of the runtime, flying alone from the start."""

    def __init__(self, name: LawName) -> None:
        self._law = make_law(name, load_settings())
        self._reference = np.zeros((0, N_REFERENCE))

    def brief(self, reference: np.ndarray) -> None:
        """Begin a flight along a reference (T, 3) [rad]."""
        self._law.reset()
        self._reference = reference

    def __call__(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return the command (3,) [rad] at sample k and measured state x (12,), limited as the runtime limits it."""
        command = self._law.steer(x, self._reference[k]).clip(ACTION_LOW, ACTION_HIGH)
        self._law.sent(command)
        return command


def cells_of(flown: Flown, trials: list[Trial]) -> list[Cell]:
    """Return one cell for each policy, scored from the onset on."""
    since = np.array([round(trial.onset / DT) for trial in trials])
    scores = np.nan_to_num(flown.nmae(since), nan=100.0)
    return [
        Cell(nmae=row.tolist(), smoothness=smooth.tolist(), lost=lost.tolist())
        for row, smooth, lost in zip(scores, flown.smoothness(since), flown.lost, strict=True)
    ]


def cached(path: Path, key: str, make: Callable[[], Measured]) -> Measured:
    """Return what ``path`` holds when it was measured under the same key, or measure and keep it."""
    if path.exists():
        kept = load_json(path, Kept, "measurement")
        if kept.key == key:
            return kept.measured
    measured = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_bytes(to_json(Kept(key=key, measured=measured)))
    os.replace(partial, path)
    return measured


class Kept(Settings, frozen=True):
    """One case in the cache."""

    key: str
    """Hash of everything that decides it."""
    measured: Measured


def key_of(cast: Folder, serl: Folder, protocol: Protocol, case: Case) -> str:
    """Return a hash of what a case's measurement depends on."""
    return hashlib.sha256(msgspec.json.encode(["all members", cast.sha256, serl.sha256, protocol, case])).hexdigest()


@click.command()
@click.option("--population", type=click.Path(path_type=Path), default="populations/citation", show_default=True)
@click.option("--serl", type=click.Path(path_type=Path), default="populations/serl50", show_default=True)
@click.option("--cache", type=click.Path(path_type=Path), default="runs/bench_cast", show_default=True)
@click.option("--minutes", type=click.FloatRange(0.0), help="Begin no case after so many minutes; run again to go on.")
def main(population: Path, serl: Path, cache: Path, minutes: float | None) -> None:
    """Measure the cast; write results/cast.json and docs/img/cast_coverage.png."""
    began = time.monotonic()
    protocol = Protocol()
    cast, peer = Folder(population), Folder(serl)
    measured: dict[str, Measured] = {}
    seconds = 0.0
    bench = Bench(cast, peer, protocol)
    hard_names = [case.name for case in bench.settings.cases]
    plan = [*((case, True) for case in bench.settings.cases), *((case, False) for case in EASY)]
    for number, (case, hard) in enumerate(plan, 1):
        if minutes is not None and time.monotonic() - began > 60.0 * minutes:
            click.echo("stopped; the same command goes on")
            raise SystemExit(3)

        def make(case: Case = case, hard: bool = hard) -> Measured:
            start = time.monotonic()
            fresh = bench.measure(case, hard)
            return msgspec.structs.replace(fresh, seconds=round(time.monotonic() - start, 1))

        path = cache / f"{zlib.crc32(case.name.encode()):08x}.json"
        measured[case.name] = cached(path, key_of(cast, peer, protocol, case), make)
        seconds += measured[case.name].seconds
        click.echo(f"{number} of {len(plan)}: {case.name}")
    coverage_picture(cast.scores, bench.for_case, hard_names, PICTURE)
    written = write("cast", result(measured, cast.members, cast.training, protocol_words(protocol), seconds))
    click.echo(f"wrote {written}")


def protocol_words(protocol: Protocol) -> Mapping[str, float]:
    """Return the protocol's numbers for the notes."""
    return msgspec.to_builtins(protocol)


if __name__ == "__main__":
    run(main)
