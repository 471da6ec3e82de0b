"""The commands that the imagination starts from: oldest first, padded with the first one."""

import numpy as np
import pytest

from runtime.config import Adaptation
from runtime.history import CommandHistory
from runtime.identification import IncrementalModel


def command(number: float) -> np.ndarray:
    return np.array([number, -number, 0.0])


@pytest.mark.parametrize("sent", [1, 2, 5, 6, 13])
def test_the_last_commands_oldest_first(sent):
    history = CommandHistory(5)
    for number in range(1, sent + 1):
        history.push(command(number))
    expected = [max(number, 1) for number in range(sent - 4, sent + 1)]
    np.testing.assert_array_equal(history.latest()[:, 0], expected)
    assert history.latest().dtype == np.float32


def test_what_is_handed_out_is_a_copy_and_a_restart_begins_anew():
    history = CommandHistory(3)
    np.testing.assert_array_equal(history.latest(), np.zeros((3, 3)))
    history.push(command(1.0))
    before = history.latest()
    history.push(command(2.0))
    np.testing.assert_array_equal(before[:, 0], [1.0, 1.0, 1.0])
    history.restart()
    history.push(command(7.0))
    np.testing.assert_array_equal(history.latest()[:, 0], [7.0, 7.0, 7.0])


def test_a_snapshot_holds_lag_and_delay_and_a_gap_forgets_them():
    model = IncrementalModel(Adaptation(prior="none"), 1, max_delay=4)
    for tick in range(8):
        model.observe(np.full(10, 0.01 * tick))
        model.command(command(tick))
    snapshot = model.snapshot()
    assert snapshot.delay == 0
    np.testing.assert_array_equal(snapshot.commands[:, 0], [2, 3, 4, 5, 6, 7])
    model.restart_history()
    model.command(command(9))
    np.testing.assert_array_equal(model.snapshot().commands[:, 0], [9] * 6)
