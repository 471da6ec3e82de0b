"""Chapter 8's result: claims that can fail, losing cases shown."""

from __future__ import annotations

import msgspec
import pytest

from scenarios.chapter8.command import measured
from scenarios.score import Score
from task.results import Claim

BASE = Score(
    nmae=10.0, nmae_theta=6.0, nmae_phi=4.0, nmae_beta=20.0, nmae_attitude=5.0, beta_deg=0.2, nmae_before=5.0,
    nmae_after=12.0, smoothness=-3.0, largest_step_deg=0.5, lost_at=None, switches=0, late_ticks=0,
)  # fmt: skip


def flown(*nmae: float, lost: int | None = None) -> dict[str, Score]:
    return {
        f"evaluation-{i}": msgspec.structs.replace(BASE, nmae=value, lost_at=30.0 if i == lost else None)
        for i, value in enumerate(nmae)
    }


SCORES = {
    "none": flown(10.0, 20.0, 10.0),
    "thesis-hard": flown(9.0, 22.0, 11.0),
    "thesis-soft": flown(7.0, 14.0, 7.5),
    "understudy-hard": flown(6.0, 13.0, 7.0),
    "understudy-soft": flown(6.0, 12.0, 90.0, lost=2),
}


def test_claims_hold_or_do_not_by_the_paired_changes() -> None:
    result = measured(SCORES, "cast", [1, 2, 3], 60.0, "make chapter8")
    claims: dict[str, Claim] = {c.claim: c for c in result.claims}
    hard = claims["thesis-hard: mean change of nMAE"]
    assert hard.value == pytest.approx((-10.0 + 10.0 + 10.0) / 3, rel=1e-3)
    assert hard.holds is False
    soft = claims["thesis-soft: mean change of nMAE"]
    assert soft.value == pytest.approx((-30.0 - 30.0 - 25.0) / 3, rel=1e-3)
    assert soft.holds is True
    assert claims["thesis: mean change of nMAE, soft against hard"].holds is True
    assert claims["understudy: mean change of nMAE, soft against hard"].value == pytest.approx(-7.692 / 2, rel=1e-3)
    assert claims["none: mean nMAE"].value == pytest.approx(40.0 / 3, rel=1e-3)
    assert result.runs == 15


def test_tables_show_the_worst_and_what_was_lost() -> None:
    result = measured(SCORES, "cast", [1, 2, 3], 60.0, "make chapter8")
    by_mode, by_reference = result.tables
    rows = {row[0]: dict(zip(by_mode.columns, row, strict=True)) for row in by_mode.rows}
    assert rows["thesis-hard"]["worst change %"] == pytest.approx(10.0)
    assert rows["thesis-hard"]["flights > 2 % worse"] == 2
    assert rows["thesis-soft"]["median change %"] == pytest.approx(-30.0)
    assert rows["none"]["mean change %"] is None
    assert (rows["understudy-soft"]["lost"], rows["understudy-soft"]["worst nMAE %"]) == (1, 12.0)
    assert by_reference.rows[2] == ["evaluation-2", 10.0, 11.0, 7.5, 7.0, "lost at 30.0 s"]
    assert any("1 in understudy-soft" in note for note in result.notes)
