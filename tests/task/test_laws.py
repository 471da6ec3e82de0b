"""What a law sees, commands and remembers."""

from __future__ import annotations

import numpy as np
import pytest

from task.laws import N_MEMORY, N_SEEN, SEEN, reference_rates, seen, step
from task.limits import DT
from task.state import N_ACTION, STATE


def test_the_parts_fill_what_is_seen_without_gaps():
    ends = [0, *(part.stop for part in SEEN)]
    assert [part.start for part in SEEN] == ends[:-1]
    assert ends[-1] == N_SEEN == 30


def test_each_part_lies_where_it_is_said_to_lie():
    x, dx = np.arange(1.0, 11.0), np.arange(11.0, 21.0)
    y = seen(np.stack([x, -x]), np.stack([dx, -dx]), np.full(3, 21.0), np.full(3, 22.0), np.full(3, 23.0))
    for batch, sign in enumerate((1.0, -1.0)):
        assert y[batch, SEEN.one] == 1.0
        for part, value in ((SEEN.x, x), (SEEN.dx, dx)):
            expected = sign * value
            expected[[STATE.psi, STATE.h]] = 0.0
            np.testing.assert_array_equal(y[batch, part], expected)
        for part, value in ((SEEN.acted, 21.0), (SEEN.reference, 22.0), (SEEN.rate, 23.0)):
            np.testing.assert_array_equal(y[batch, part], value)


@pytest.mark.parametrize("samples", [2, 3, 10])
def test_the_rate_looks_back_and_at_the_start_ahead(samples):
    reference = np.random.default_rng(0).normal(size=(samples, 3))
    rates = reference_rates(reference)
    assert rates.shape == (samples - 1, 3)
    np.testing.assert_allclose(rates[0], (reference[1] - reference[0]) / DT)
    for t in range(1, samples - 1):
        np.testing.assert_allclose(rates[t], (reference[t] - reference[t - 1]) / DT)


def test_the_command_is_limited_and_the_memory_is_not():
    maps = np.zeros((2, N_ACTION + N_MEMORY, N_MEMORY + N_SEEN))
    maps[0, 0, N_MEMORY], maps[0, 1, 2] = 5.0, -5.0
    maps[1, 2, N_MEMORY], maps[1, N_ACTION + 4, 2] = 0.01, 3.0
    memory, y = np.zeros((2, N_MEMORY)), np.zeros((2, N_SEEN))
    memory[:, 2], y[:, SEEN.one] = 1.0, 1.0
    command, remembered = step(maps, memory, y)
    limit = np.deg2rad(10.0)
    np.testing.assert_allclose(command, [[limit, -limit, 0.0], [0.0, 0.0, 0.01]])
    np.testing.assert_array_equal(remembered[0], 0.0)
    np.testing.assert_array_equal(remembered[1], 3.0 * np.eye(N_MEMORY)[4])
