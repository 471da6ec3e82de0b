"""Is one controller better than another? The thesis's t-test, and a paired bootstrap beside it."""

from __future__ import annotations

import numpy as np
from scipy import stats

SIGNIFICANT = 0.05
RESAMPLES = 10_000


def t_test(a: np.ndarray, b: np.ndarray) -> float:
    """Return the tail probability p of equal means of two samples (thesis section IV): Student, two-sided.

    Against a sample of one, that one is taken for the mean.
    """
    if min(len(a), len(b)) == 1:
        many, mean = (a, b) if len(b) == 1 else (b, a)
        return float(stats.ttest_1samp(many, mean[0]).pvalue)
    if np.ptp(a) == np.ptp(b) == 0.0:
        return 1.0 if a[0] == b[0] else 0.0
    return float(stats.ttest_ind(a, b).pvalue)


def paired_interval(a: np.ndarray, b: np.ndarray, seed: int = 0) -> tuple[float, float, float]:
    """Return the mean of a - b and its 95 % bootstrap interval, resampling the references that both flew.

    a, b: (E,), figures on the same references. The t-test takes the samples for independent, although they are
    pairs, and for normal; this takes them for neither.
    """
    difference = a - b
    index = np.random.default_rng(seed).integers(len(difference), size=(RESAMPLES, len(difference)))
    low, high = np.percentile(difference[index].mean(axis=1), [2.5, 97.5])
    return float(difference.mean()), float(low), float(high)


def best(samples: dict[str, np.ndarray]) -> str | None:
    """Return whose mean is significantly lower than that of every other (p < 0.05); None where nobody's is."""
    order = sorted(samples, key=lambda name: float(samples[name].mean()))
    first, others = order[0], order[1:]
    return first if all(t_test(samples[first], samples[name]) < SIGNIFICANT for name in others) else None
