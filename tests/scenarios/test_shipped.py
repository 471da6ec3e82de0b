"""Figures of the shipped scenarios: a lost aircraft and harm done are claims that do not hold."""

from __future__ import annotations

import msgspec
from click.testing import CliRunner

from scenarios.schema import Scenario, available
from scenarios.score import Score
from scenarios.shipped.command import PICTURED, Flown, main, measured
from scenarios.summary import summarise
from task.results import read

SCORE = Score(
    nmae=1.0, nmae_theta=0.5, nmae_phi=0.5, nmae_beta=2.0, nmae_attitude=0.5, beta_deg=0.02, nmae_before=0.5,
    nmae_after=1.2, smoothness=-30.0, largest_step_deg=2.0, lost_at=None, switches=1, late_ticks=0,
)  # fmt: skip


def flown(**nmae: float | None) -> Flown:
    """Return one flight of each mode; without an nMAE it was lost at 22 s."""
    lost = msgspec.structs.replace(SCORE, lost_at=22.0)
    scores = {
        mode.replace("_", "-"): {"base": msgspec.structs.replace(SCORE, nmae=value) if value else lost}
        for mode, value in nmae.items()
    }
    return Flown(Scenario(title="a fault"), summarise(scores))


def claims(**nmae: float | None) -> dict[str, tuple]:
    result = measured({"x": flown(**nmae)}, 10.0, "make scenarios")
    assert result.runs == len(nmae)
    assert len(result.tables[0].rows) == len(nmae)
    return {c.claim: (c.value, c.target, c.holds) for c in result.claims}


def test_who_keeps_the_aircraft_is_told_with_those_that_lose_it():
    assert claims(none=None, ensemble=0.1, pid=None, indi=0.2) == {
        "x, ensemble: nMAE (lost: none, pid)": (0.1, "not lost", True)
    }
    assert claims(none=1.0, ensemble=None) == {"x, ensemble: nMAE": ("lost", "not lost", False)}


def test_harm_against_no_adaptation_does_not_hold():
    words = "x, understudy-soft: change of nMAE against no adaptation"
    assert claims(none=1.0, thesis_soft=0.9, understudy_soft=1.01)[words] == (1.0, "<= 2", True)
    assert claims(none=1.0, understudy_soft=1.5)[words] == (50.0, "<= 2", False)
    assert claims(none=1.0, pid=0.1) == {}


def test_one_scenario_is_flown_and_written(tmp_path):
    ended = CliRunner().invoke(
        main, ["--scenario", "nominal", "--out", str(tmp_path / "flights"), "--results", str(tmp_path)]
    )
    assert ended.exit_code == 0, ended.output
    result = read(tmp_path / "scenarios.json")
    assert result.command == "python -m scenarios.shipped --scenario nominal"
    (table,) = result.tables
    assert [row[0] for row in table.rows] == [
        "none",
        "thesis-hard",
        "thesis-soft",
        "understudy-hard",
        "understudy-soft",
    ]
    assert result.seconds > 0.0
    assert set(PICTURED) <= set(available())


def test_an_unknown_scenario_is_refused_in_one_line():
    ended = CliRunner().invoke(main, ["--scenario", "nowhere"])
    assert ended.exit_code == 2
    assert "'nowhere' is not one of" in ended.output
