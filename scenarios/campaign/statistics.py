"""Paired statistics of two ways of adapting on the same flights; pure functions of records."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from scenarios.campaign.scores import Record

Key = tuple[str, str, int]
"""Suite, fault, number of the flight."""
Flights = Mapping[Key, Record]
"""The flights of one row."""

RESAMPLES = 2000
CONFIDENCE = 0.95
SLIGHTLY, CLEARLY = 2.0, 5.0
"""A flight counts as worse when its nMAE grows by more than this [%]."""


class Paired(NamedTuple):
    """One row against another on the flights that both flew; a change is that of nMAE, negative is better."""

    flights: int
    """Flights that both flew."""
    both: int
    """... and that neither lost: the changes are taken over these."""
    mean: float
    """Mean of the flights' relative changes [%]."""
    low: float
    high: float
    """95 % bootstrap interval of that mean [%]."""
    median: float
    worst: float
    """[%]"""
    of_means: float
    """Relative change of the mean nMAE [%]."""
    slightly_worse: float
    """Share of the flights that got more than 2 % worse; one that was lost where the other survived is one [%]."""
    clearly_worse: float
    """The same for 5 % [%]."""
    saved: int
    """Flights that survived where the other row lost its own."""
    lost: int
    """The reverse."""


def key(record: Record) -> Key:
    """Return which flight a record is of."""
    return record.suite, record.fault, record.index


def interval(values: Sequence[float], seed: int = 0) -> tuple[float, float]:
    """Return the percentile bootstrap interval of the mean; NaN without two values."""
    if len(values) < 2:
        return math.nan, math.nan
    found = stats.bootstrap(
        (np.asarray(values),), np.mean, n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval  # fmt: skip
    return float(found.low), float(found.high)


def paired(ours: Flights, other: Flights) -> Paired:
    """Return how ``ours`` compares with ``other``."""
    common = [k for k in ours if k in other]
    both = [k for k in common if ours[k].survived and other[k].survived]
    changes = [100.0 * (ours[k].nmae / other[k].nmae - 1.0) for k in both]
    lost = sum(other[k].survived and not ours[k].survived for k in common)
    saved = sum(ours[k].survived and not other[k].survived for k in common)
    low, high = interval(changes)
    means = [statistics.fmean(row[k].nmae for k in both) if both else math.nan for row in (ours, other)]
    return Paired(
        flights=len(common),
        both=len(both),
        mean=statistics.fmean(changes) if changes else math.nan,
        low=low,
        high=high,
        median=statistics.median(changes) if changes else math.nan,
        worst=max(changes, default=math.nan),
        of_means=100.0 * (means[0] / means[1] - 1.0) if both else math.nan,
        slightly_worse=_share(sum(c > SLIGHTLY for c in changes) + lost, len(common)),
        clearly_worse=_share(sum(c > CLEARLY for c in changes) + lost, len(common)),
        saved=saved,
        lost=lost,
    )


def _share(count: int, of: int) -> float:
    return 100.0 * count / of if of else math.nan


def survival(flights: Flights, among: Flights | None = None) -> float:
    """Return the share of flights that survived [%], of all or of those that ``among`` survived; NaN of none."""
    return _share(*alive(flights, among))


def mean(values: Sequence[float]) -> float:
    """Return the mean of what is known; NaN without any."""
    known = [v for v in values if math.isfinite(v)]
    return statistics.fmean(known) if known else math.nan


def median(values: Sequence[float]) -> float:
    """Return the median, infinite values included; NaN without any."""
    known = [v for v in values if not math.isnan(v)]
    return statistics.median(known) if known else math.nan


def alive(flights: Flights, among: Flights | None = None) -> tuple[int, int]:
    """Return how many flights survived and of how many, of all or of those that ``among`` survived."""
    kept = [r for k, r in flights.items() if among is None or (k in among and among[k].survived)]
    return sum(r.survived for r in kept), len(kept)


def wilson(survivors: int, flights: int) -> tuple[float, float]:
    """Return the 95 % interval of Wilson for a rate [%]; NaN of none."""
    if not flights:
        return math.nan, math.nan
    found = stats.binomtest(survivors, flights).proportion_ci(CONFIDENCE, method="wilson")
    return 100.0 * float(found.low), 100.0 * float(found.high)


def of_oracle(ours: Flights, oracle: Flights) -> float:
    """Return the median of the flights' nMAE over the oracle's, over those that both survived [-]."""
    both = [k for k, r in ours.items() if r.survived and k in oracle and oracle[k].survived]
    return median([ours[k].nmae / oracle[k].nmae for k in both])


STALLED = 1.0
"""A flight is a stalled one when its wing was, for longer than this [s]."""


def stalled(record: Record) -> bool:
    """Return whether a flight was flown on a stalled wing; False where it was not looked at."""
    return record.stalled > STALLED


def stalls(flights: Flights) -> float:
    """Return the share of stalled flights among the survivors that were looked at [%]; NaN of none."""
    kept = [r for r in flights.values() if r.survived and not math.isnan(r.stalled)]
    return _share(sum(map(stalled, kept)), len(kept))


SUITED_RATIO, SUITED_OFFSET = 1.2, 0.2
"""A member suits a flight when it survives it with at most this times the oracle's nMAE, plus this [%]."""


def bound(members: Sequence[Record]) -> float:
    """Return the nMAE [%] with which a flight is flown about as well as by the best of ``members``; NaN of nobody."""
    return SUITED_RATIO * min((m.nmae for m in members if m.survived), default=math.nan) + SUITED_OFFSET


def suited(members: Sequence[Record]) -> set[str]:
    """Return who flies one flight about as well as the best of ``members``; nobody when all are lost."""
    most = bound(members)
    return {m.member for m in members if m.survived and m.nmae <= most}


def time_to_suited(record: Record, members: Sequence[Record]) -> float:
    """Return when a suited member first flies, from the fault [s]: 0 when it did already, inf when never.

    A law in a cast is told what it does not know alone, and may suit a flight that it loses by itself. Hence whoever
    flew last was suited, too, when this very flight is as good as that.
    """
    right, last = suited(members), record.switched_at[-1]
    own = max(last, 0.0) if record.survived and record.nmae <= bound(members) else math.inf
    flying = [
        (max(at, 0.0), to)
        for i, (at, to) in enumerate(zip(record.switched_at, record.switched_to, strict=True))
        if at >= 0.0 or i + 1 == len(record.switched_at) or record.switched_at[i + 1] >= 0.0
    ]
    return min([own, *(at for at, to in flying if to in right)])
