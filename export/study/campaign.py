"""Many flights of trained actors, scored: in small batches, shown as they go, kept so that a stopped study goes on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from export.network import Network
from export.study.cases import Case, CaseFleet
from export.training.checkpoint import atomic
from export.training.evaluate import DURATION, Scores, score
from export.training.flights import draw_references
from task.reference import FamilyName, n_samples

ABREAST = 14
"""Aircraft that fly side by side: more of them no longer share a core's cache and each step takes longer."""
STORE = "study"
"""Folder within a run where its flights are kept."""
SEEDS = (71, 72, 73)
"""Of the references; neither training nor the choice of a champion draws from them."""

Progress = Callable[[int], None]
"""Told how many flights have just ended."""


class Trials(NamedTuple):
    """References that every actor of a comparison flies: ``each`` from every one of SEEDS, seed by seed."""

    each: int
    duration: float = DURATION
    """[s]."""
    family: FamilyName | Literal["published"] = "evaluation"
    first: int | None = None
    """Only so many of them, from one seed after the other; None: all."""
    until: float | None = None
    """Only so many seconds of each reference, which stays that of ``duration``; None: all."""

    @property
    def chosen(self) -> list[int]:
        """Return where these references stand among all of ``each``."""
        turns = [s * self.each + i for i in range(self.each) for s in range(len(SEEDS))]
        return sorted(turns[: self.first])

    @property
    def total(self) -> int:
        """Number of references."""
        return len(self.chosen)

    def references(self, theta_trim: float) -> np.ndarray:
        """Return the references (total, T + 1, 3) [rad] about a trim pitch [rad]."""
        streams = [np.random.default_rng(s) for s in SEEDS]
        drawn = [draw_references(rng, self.each, self.duration, theta_trim, self.family) for rng in streams]
        flown = n_samples(self.until or self.duration) + 1
        return np.concatenate(drawn)[self.chosen, :flown]

    def noise_seeds(self) -> list[int]:
        """Return a seed of the sensors' noise for each reference, the same however many there are."""
        seeds = [1000 * s + i for s in SEEDS for i in range(self.each)]
        return [seeds[i] for i in self.chosen]


def fly(
    fleet: CaseFleet, case: Case, network: Network, parameters: np.ndarray, trials: Trials, progress: Progress
) -> Scores:
    """Fly actors (P, K) on all trials of a case; return their scores, (P, trials.total)."""
    fleet.take(case)
    references, seeds = trials.references(fleet.theta_trim), trials.noise_seeds()
    rows = []
    width = -(-len(references) // -(-len(references) // ABREAST))  # batches of one size
    actors = ABREAST // width
    for p in range(0, len(parameters), actors):
        parts = []
        for e in range(0, len(references), width):
            some = slice(e, e + width)
            flights = fleet.fly_case(network, parameters[p : p + actors], references[some], seeds[some])
            parts.append(score(network, flights))
            progress(flights.length.size)
        rows.append(join(parts, axis=1))
    return join(rows, axis=0)


def join(scores: list[Scores], axis: int) -> Scores:
    """Return scores side by side: of more actors (axis 0) or of more references (axis 1)."""
    return Scores(*(np.concatenate(field, axis=axis) for field in zip(*scores, strict=True)))


def fly_once(
    store: Path,
    fleet: CaseFleet,
    case: Case,
    network: Network,
    parameters: np.ndarray,
    trials: Trials,
    progress: Progress,
) -> Scores:
    """Return what :func:`fly` returns, from ``store`` where these flights have been flown before."""
    what = msgspec.json.encode((network, case, trials, SEEDS))
    digest = hashlib.sha256(what + np.ascontiguousarray(parameters).tobytes()).hexdigest()[:16]
    path = store / f"{case.name}-{digest}.npz"
    if path.exists():
        with np.load(path, allow_pickle=False) as kept:
            scores = Scores(**{name: kept[name] for name in Scores._fields})
        progress(scores.length.size)
        return scores
    scores = fly(fleet, case, network, parameters, trials, progress)
    store.mkdir(parents=True, exist_ok=True)
    with atomic(path) as file:
        np.savez(file, allow_pickle=False, **scores._asdict())
    return scores
