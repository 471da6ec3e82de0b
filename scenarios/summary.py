"""From the scores of single flights to the rows of a table: means, worst cases, paired changes."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from scenarios.score import Score

BASELINE = "none"
"""The mode that the others are compared with."""


class Row(NamedTuple):
    """One mode over all references; means are over the flights that were not lost, None without any."""

    mode: str
    flights: int
    lost: int
    nmae: float | None
    """[%]"""
    worst: float | None
    """Largest nMAE [%]."""
    change: float | None
    """Mean of the relative changes of nMAE against no adaptation, reference by reference [%]; negative is better."""
    worst_change: float | None
    """The least favourable of them [%]."""
    theta: float | None
    phi: float | None
    beta: float | None
    """nMAE of each channel [%]."""
    beta_deg: float | None
    """Mean absolute sideslip error [deg]."""
    before: float | None
    after: float | None
    """nMAE before and after a sudden fault [%]."""
    smoothness: float | None
    """Sm [rad Hz]."""
    step: float | None
    """Largest command step of all flights [deg]."""
    switches: float
    """Mean number of changes of the cast, lost flights included."""
    late: int
    """Late ticks of all flights together."""
    lost_at: float | None
    """Mean time at which the lost flights were lost [s]."""


COLUMNS: dict[str, tuple[str, str]] = {
    "mode": ("mode", ""),
    "nmae": ("nMAE %", ".2f"),
    "worst": ("worst %", ".2f"),
    "change": ("vs none %", "+.1f"),
    "worst_change": ("worst vs none %", "+.1f"),
    "theta": ("θ %", ".2f"),
    "phi": ("φ %", ".2f"),
    "beta": ("β %", ".2f"),
    "beta_deg": ("|β| deg", ".2f"),
    "before": ("before %", ".2f"),
    "after": ("after %", ".2f"),
    "smoothness": ("Sm rad Hz", ".1f"),
    "step": ("step deg", ".2f"),
    "switches": ("switches", ".1f"),
    "late": ("late", "d"),
    "lost": ("lost", "d"),
    "lost_at": ("lost at s", ".1f"),
}
"""Field of :class:`Row`, its heading and how it is written."""

Scores = Mapping[str, Mapping[str, Score]]
"""Mode, then reference: score."""


def change(score: Score, baseline: Score) -> float | None:
    """Return the relative change of nMAE [%] on one reference; None when either flight was lost."""
    if not (score.survived and baseline.survived):
        return None
    return 100.0 * (score.nmae / baseline.nmae - 1.0)


def changes(scores: Scores, mode: str) -> list[float]:
    """Return the paired changes [%] of a mode, in the order of the references."""
    baseline = scores.get(BASELINE, {})
    if mode == BASELINE:
        return []
    paired = (change(score, baseline[name]) for name, score in scores[mode].items() if name in baseline)
    return [value for value in paired if value is not None]


def summarise(scores: Scores) -> list[Row]:
    """Return one row for each mode, in the order given."""
    return [_row(mode, list(by_reference.values()), changes(scores, mode)) for mode, by_reference in scores.items()]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return statistics.fmean(known) if known else None


def _row(mode: str, scores: list[Score], paired: list[float]) -> Row:
    kept = [s for s in scores if s.survived]
    return Row(
        mode=mode,
        flights=len(scores),
        lost=len(scores) - len(kept),
        nmae=_mean([s.nmae for s in kept]),
        worst=max((s.nmae for s in kept), default=None),
        change=_mean(paired),
        worst_change=max(paired, default=None),
        theta=_mean([s.nmae_theta for s in kept]),
        phi=_mean([s.nmae_phi for s in kept]),
        beta=_mean([s.nmae_beta for s in kept]),
        beta_deg=_mean([s.beta_deg for s in kept]),
        before=_mean([s.nmae_before for s in kept]),
        after=_mean([s.nmae_after for s in kept]),
        smoothness=_mean([s.smoothness for s in kept]),
        step=max((s.largest_step_deg for s in kept), default=None),
        switches=statistics.fmean(s.switches for s in scores) if scores else 0.0,
        late=sum(s.late_ticks for s in scores),
        lost_at=_mean([s.lost_at for s in scores]),
    )


def text(value: object, form: str) -> str:
    """Return one cell; what is not known is a dash."""
    return "–" if value is None else format(value, form)


def cells(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Return headings and cells of the columns that say something; every row is flown on the same references."""
    shown = [name for name in COLUMNS if name in {"mode", "late", "lost"} or any(_says(row, name) for row in rows)]
    if all(row.flights <= 1 for row in rows):
        shown = [name for name in shown if name not in {"worst", "worst_change"}]
    return (
        [COLUMNS[name][0] for name in shown],
        [[text(getattr(row, name), COLUMNS[name][1]) for name in shown] for row in rows],
    )


def _says(row: Row, name: str) -> bool:
    return getattr(row, name) is not None
