"""Flies every candidate in every case on tuning trials, chooses the cast, and writes it as a trained run."""

from __future__ import annotations

import hashlib
import os
import platform
import zlib
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import msgspec
import numpy as np

from export.cast.breed import MAIN, ROBUST, Breeder, Report, slug
from export.cast.cases import Case
from export.cast.coverage import covers, improve, set_cover
from export.cast.variants import variant_name
from export.mirrors import AXES
from export.population import Description, Member, Population, save_run
from task.config import Settings, load_json, to_json
from task.errors import UserError
from task.files import atomic

TUNING_STREAM = 1_000_003
"""Added to the run's seed: tuning trials are of another stream than those of the searches."""


class Tuned(Settings, frozen=True):
    """What the candidates made of one case's tuning trials: a file in the run's folder ``tuning``."""

    case: str
    key: str
    """Hash of what decides the rest: case, candidates' parameters, trials."""
    candidates: tuple[str, ...]
    cost: tuple[float, ...]
    """Mean over the trials [% nMAE]."""
    lost: tuple[int, ...]
    """Flights lost."""


def candidates(breeder: Breeder) -> dict[str, np.ndarray]:
    """Return everybody who may enter the cast, main member first; raise UserError while something is not bred."""
    missing = sorted({case for case, round_, _ in breeder.plan() if (case, round_) not in breeder.bred})
    if missing:
        raise UserError(f"{breeder.folder}: not bred yet: {', '.join(missing)}; run 'python -m export.cast breed'")
    return breeder.variants()


def tune(breeder: Breeder, report: Report, stop: Callable[[], bool] = lambda: False) -> bool:
    """Fly what is missing of every candidate in every case; return whether nothing is left."""
    everybody = candidates(breeder)
    names, rows = tuple(everybody), np.array(list(everybody.values()))
    folder = breeder.folder / "tuning"
    folder.mkdir(exist_ok=True)
    for name, case in breeder.cases.items():
        path = folder / f"{slug(name)}.json"
        key = tuning_key(breeder, case, rows)
        if path.exists() and load_json(path, Tuned, "tuning scores").key == key:
            continue
        if stop():
            return False
        rng = np.random.default_rng([breeder.settings.seed + TUNING_STREAM, zlib.crc32(name.encode())])
        sudden = name in breeder.hard
        trials = breeder.drawer.trials(rng, case, breeder.settings.tuning, sudden)
        breeder.judge.opening = breeder.result(MAIN) if sudden else None
        cost = breeder.judge(rows, trials)
        lost = (cost >= breeder.settings.trial.lost).sum(axis=1)
        tuned = Tuned(
            case=name, key=key, candidates=names, cost=tuple(cost.mean(axis=1).tolist()), lost=tuple(map(int, lost))
        )
        with atomic(path) as file:
            file.write(to_json(tuned))
        report(f"{name}: best {names[int(cost.mean(axis=1).argmin())]} {cost.mean(axis=1).min():.2f} %", True)
    return True


def tuning_key(breeder: Breeder, case: Case, rows: np.ndarray) -> str:
    """Return a hash of everything that the scores of a case's tuning trials depend on."""
    s = breeder.settings
    parts = [s.seed, s.tuning, s.trial, s.layers, s.input_scale, case, case.name in breeder.hard]
    return hashlib.sha256(msgspec.json.encode(parts) + rows.tobytes()).hexdigest()[:16]


class Chosen(Settings, frozen=True):
    """The cast and why: goes into the provenance."""

    members: tuple[str, ...]
    """In the order in which they were chosen."""
    needed: int
    """The first so many are the main member, its mirrors and what covers the cases; the others lower the cost."""
    uncovered: tuple[str, ...]
    """Cases that no candidate covers, those in which the specialist itself loses every tuning flight included."""
    for_case: dict[str, str]
    """The member that costs least on each case's tuning trials: whom an oracle would fly."""


def choose(breeder: Breeder, tuned: dict[str, Tuned]) -> Chosen:
    """Return the cast: main member, mirrors, greedy set cover, then whoever still lowers the cost."""
    settings = breeder.settings
    names = list(next(iter(tuned.values())).candidates)
    cost = np.array([t.cost for t in tuned.values()]).T
    lost = np.array([t.lost for t in tuned.values()]).T
    specialist = np.array([names.index(case) if case in names else names.index(MAIN) for case in tuned])
    hopeless = lost.min(axis=0) >= settings.tuning
    mirrors = [names.index(variant_name(MAIN, 1.0, axes)) for axes in AXES]
    covered = covers(cost, lost, specialist, settings.within)
    covered[:, hopeless] = False
    cast = set_cover(covered, [names.index(MAIN), *mirrors])
    needed = len(cast)
    if needed > settings.members:
        raise UserError(
            f"{breeder.folder}: covering the cases takes {needed} members, more than members = {settings.members}; "
            "raise 'within'"
        )
    cast = improve(cost[:, ~hopeless], cast, settings.members, settings.least_gain)
    missed = np.atleast_1d(~covered[cast].any(axis=0))
    best = np.array(cast)[cost[cast].argmin(axis=0)]
    return Chosen(
        members=tuple(names[i] for i in cast),
        needed=needed,
        uncovered=tuple(case for case, miss in zip(tuned, missed, strict=True) if miss),
        for_case={case: names[i] for case, i in zip(tuned, best, strict=True)},
    )


def write(breeder: Breeder) -> Chosen:
    """Choose the cast and write the trained run: parameters.npy, population.json, config.toml."""
    everybody = candidates(breeder)
    tuned = {
        name: load_json(breeder.folder / "tuning" / f"{slug(name)}.json", Tuned, "tuning scores; run 'tune'")
        for name in breeder.cases
    }
    chosen = choose(breeder, tuned)
    names = list(everybody)
    members = tuple(
        Member(name=name, scores={case: round(t.cost[names.index(name)], 3) for case, t in tuned.items()})
        for name in chosen.members
    )
    parameters = np.array([everybody[name] for name in chosen.members], dtype=np.float32)
    description = Description(
        network=breeder.network, members=members, champion=MAIN, training=provenance(breeder, chosen)
    )
    save_run(Population(description, parameters), breeder.folder)
    return chosen


def provenance(breeder: Breeder, chosen: Chosen) -> dict[str, Any]:
    """Return what made this cast: configuration, seed, everything bred with its parameters, cost, versions."""
    last = {case: bred for (case, _), bred in sorted(breeder.bred.items())}
    return {
        "algorithm": "CMA-ES for each case, chosen for coverage",
        "config": msgspec.to_builtins(breeder.settings),
        "seed": breeder.settings.seed,
        "teachers": [],
        "frames": sum(bred.frames for bred in breeder.bred.values()),
        "seconds": round(sum(bred.seconds for bred in breeder.bred.values())),
        "chosen": msgspec.to_builtins(chosen),
        "single_robust_policy": list(last[ROBUST].parameters),
        "bred": [msgspec.to_builtins(bred) for bred in last.values() if bred.case != ROBUST],
        "scores": "members' scores are mean costs [% nMAE] on the tuning trials; 100 and more: flights lost",
        "cores": os.cpu_count(),
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "cma", "jsbsim")},
        },
    }
