"""Many flights of trained actors, scored: in small batches, shown as they go, kept so that a stopped study goes on."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from export.network import Network
from export.study.cases import Case, CaseFleet
from export.training.evaluate import DURATION, Scores, score
from export.training.flights import draw_references
from task.errors import UserError
from task.files import atomic, make_folder
from task.reference import FamilyName

ABREAST = 14
"""Aircraft that fly side by side: more of them no longer share a core's cache and each step takes longer."""
STORE = "study"
"""Folder within a run where its flights are kept."""
SEEDS = (71, 72, 73)
"""Of the references; neither training nor the choice of a champion draws from them."""

Progress = Callable[[int], None]
"""Told how many flights have just ended."""


class Trials(NamedTuple):
    """References that every actor of a comparison flies, one from each of SEEDS in turn."""

    number: int
    """Number ``start`` to ``number`` - 1 of them."""
    duration: float = DURATION
    """[s]."""
    family: FamilyName | Literal["published"] = "evaluation"
    start: int = 0

    @property
    def total(self) -> int:
        """How many they are."""
        return self.number - self.start

    def parts(self, size: int) -> list[Trials]:
        """Return these references in groups of at most ``size``."""
        starts = range(self.start, self.number, size)
        return [self._replace(start=i, number=min(i + size, self.number)) for i in starts]

    def references(self, theta_trim: float) -> np.ndarray:
        """Return the references (total, T + 1, 3) [rad] about a trim pitch [rad]."""
        each = -(-self.number // len(SEEDS))
        streams = [np.random.default_rng(s) for s in SEEDS]
        drawn = [draw_references(rng, each, self.duration, theta_trim, self.family) for rng in streams]
        return np.stack(drawn, axis=1).reshape(each * len(SEEDS), *drawn[0].shape[1:])[self.start : self.number]

    def noise_seeds(self) -> list[int]:
        """Return a seed of the sensors' noise for each reference."""
        return [1000 * SEEDS[j % len(SEEDS)] + j // len(SEEDS) for j in range(self.start, self.number)]


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
    fleet.take(case)
    what = [msgspec.json.encode((network, case, trials.noise_seeds()))]
    what += [np.ascontiguousarray(a).tobytes() for a in (parameters, trials.references(fleet.theta_trim))]
    digest = hashlib.sha256(b"".join(what)).hexdigest()[:16]
    path = store / f"{case.name}-{digest}.npz"
    if path.exists():
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
                scores = Scores(**{name: kept[name] for name in Scores._fields})
        except (OSError, ValueError, AttributeError, KeyError, EOFError, zipfile.BadZipFile):
            raise UserError(f"{path}: holds no flights; delete it, and they are flown again") from None
        progress(scores.length.size)
        return scores
    scores = fly(fleet, case, network, parameters, trials, progress)
    make_folder(store)
    with atomic(path) as file:
        np.savez(file, allow_pickle=False, **scores._asdict())
    return scores
