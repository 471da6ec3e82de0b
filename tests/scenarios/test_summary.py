"""Rows of a table from scores: means over survivors, paired changes."""

from __future__ import annotations

import msgspec
import pytest

from scenarios.report import best_row
from scenarios.score import Score
from scenarios.summary import cells, changes, summarise

BASE = Score(
    nmae=10.0, nmae_theta=6.0, nmae_phi=4.0, nmae_beta=20.0, nmae_attitude=5.0, beta_deg=0.2, nmae_before=None,
    nmae_after=None, smoothness=-3.0, largest_step_deg=0.5, lost_at=None, switches=0, late_ticks=0,
)  # fmt: skip


def score(nmae: float, **changed: object) -> Score:
    return msgspec.structs.replace(BASE, nmae=nmae, **changed)


SCORES = {
    "none": {"a": score(10.0), "b": score(20.0), "c": score(30.0, lost_at=12.0)},
    "understudy-soft": {
        "a": score(5.0, switches=3, largest_step_deg=0.7),
        "b": score(22.0, switches=1, late_ticks=2),
        "c": score(15.0, switches=2),
    },
    "thesis-hard": {"a": score(1.0, lost_at=3.0), "b": score(2.0, lost_at=3.0), "c": score(3.0, lost_at=3.0)},
}


def test_changes_are_paired_by_reference_and_leave_out_what_was_lost() -> None:
    assert changes(SCORES, "understudy-soft") == pytest.approx([-50.0, 10.0])
    assert changes(SCORES, "none") == []
    assert changes(SCORES, "thesis-hard") == []


def test_rows_are_means_over_what_was_not_lost() -> None:
    none, soft, hard = summarise(SCORES)
    assert (none.nmae, none.worst, none.lost, none.flights) == (pytest.approx(15.0), 20.0, 1, 3)
    assert (soft.nmae, soft.worst, soft.lost) == (pytest.approx(14.0), 22.0, 0)
    assert (soft.change, soft.worst_change) == (pytest.approx(-20.0), pytest.approx(10.0))
    assert (soft.switches, soft.late, soft.step) == (pytest.approx(2.0), 2, 0.7)
    assert (none.lost_at, soft.lost_at, hard.lost_at) == (12.0, None, 3.0)
    assert (hard.nmae, hard.worst, hard.lost, hard.step) == (None, None, 3, None)


def test_the_best_row_first_of_all_loses_no_aircraft() -> None:
    assert best_row(summarise(SCORES)) == 1
    cheap = {"none": {"a": score(1.0, lost_at=1.0), "b": score(1.0)}, "thesis-soft": {"a": score(9.0), "b": score(9.0)}}
    assert best_row(summarise(cheap)) == 1


def test_columns_that_say_nothing_are_left_out() -> None:
    headings, body = cells(summarise(SCORES))
    assert "before %" not in headings
    assert {"worst %", "vs none %", "worst vs none %", "late", "lost"} <= set(headings)
    assert body[2][headings.index("nMAE %")] == "–"
    single = {mode: {"a": by["a"]} for mode, by in SCORES.items()}
    assert "worst %" not in cells(summarise(single))[0]
