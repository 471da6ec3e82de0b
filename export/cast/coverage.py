"""Who stays: the fewest policies that cover every case, then those that still lower the cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def covers(cost: np.ndarray, lost: np.ndarray, specialist: np.ndarray, within: float) -> np.ndarray:
    """Return which candidate covers which case, (P, C) bool.

    cost, lost: (P, C) mean cost [% nMAE] and flights lost of each candidate in each case; specialist: (C,) row of the
    case's own specialist. A case is covered by who loses no more flights than its specialist and costs at most
    ``within`` times as much.
    """
    c = np.arange(cost.shape[1])
    return (lost <= lost[specialist, c]) & (cost <= within * cost[specialist, c])


def set_cover(covered: np.ndarray, chosen: Sequence[int]) -> list[int]:
    """Return ``chosen`` and, greedily, the candidates that cover most of what is left; covered: (P, C) bool.

    Ties go to the first. What nobody covers stays uncovered.
    """
    cast = list(chosen)
    open_ = ~covered[cast].any(axis=0)
    while (gain := (covered & open_).sum(axis=1)).max() > 0:
        cast.append(int(np.argmax(gain)))
        open_ &= ~covered[cast[-1]]
    return cast


def improve(cost: np.ndarray, chosen: Sequence[int], most: int, least_gain: float) -> list[int]:
    """Return ``chosen`` and, one by one, whoever lowers the mean logarithm of the best cost most.

    cost: (P, C) [% nMAE]. Ends with ``most`` members, or when nobody lowers it by ``least_gain`` any more.
    """
    cast = list(chosen)
    log_cost = np.log(cost)
    best = log_cost[cast].min(axis=0)
    while len(cast) < most:
        gain = np.maximum(0.0, best - log_cost).mean(axis=1)
        if gain.max() < least_gain:
            break
        cast.append(int(np.argmax(gain)))
        best = np.minimum(best, log_cost[cast[-1]])
    return cast
