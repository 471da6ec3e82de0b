"""The tests of the study on samples whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from export.study.statistics import best, paired_interval, t_test


def test_t_test_is_students():
    rng = np.random.default_rng(0)
    a, b = rng.normal(0.0, 1.0, 30), rng.normal(0.5, 1.0, 30)
    pooled = np.sqrt((a.var(ddof=1) + b.var(ddof=1)) / 30)
    expected = 2.0 * stats.t.sf(abs(a.mean() - b.mean()) / pooled, 58)
    assert t_test(a, b) == pytest.approx(expected)


def test_t_test_against_one_number():
    a = np.random.default_rng(3).normal(1.0, 0.5, 20)
    expected = 2.0 * stats.t.sf(abs(a.mean() - 2.0) / (a.std(ddof=1) / np.sqrt(20)), 19)
    assert t_test(a, np.array([2.0])) == t_test(np.array([2.0]), a) == pytest.approx(expected)


def test_t_test_of_constants():
    assert t_test(np.ones(3), np.ones(3)) == 1.0
    assert t_test(np.ones(3), np.zeros(3)) == 0.0


def test_pairs_tell_apart_what_samples_do_not():
    """Two controllers a little apart on references far apart: the t-test sees nothing, the pairs do."""
    references = np.linspace(1.0, 9.0, 30)
    worse = references + 0.2 + 0.05 * np.random.default_rng(1).normal(size=30)
    assert t_test(worse, references) > 0.5
    difference, low, high = paired_interval(worse, references)
    assert low > 0.1
    assert low < difference < high
    assert difference == pytest.approx((worse - references).mean())
    assert paired_interval(worse, references) == (difference, low, high)


def test_best_must_beat_everybody():
    rng = np.random.default_rng(2)
    samples = {name: rng.normal(mean, 0.5, 30) for name, mean in (("a", 1.0), ("b", 3.0), ("c", 3.0))}
    assert best(samples) == "a"
    samples["a"] = samples["b"] + 0.01
    samples["c"] += 5.0
    assert best(samples) is None
