"""Which flights a campaign flies: balanced, seeded, and two halves that share nothing."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from scenarios.campaign.command import QUICK, chosen_cells, quick_faults
from scenarios.campaign.design import DURATION, EARLIEST, FACTORS, LATEST, cells, reference_rows
from scenarios.campaign.rows import choose_rows
from scenarios.campaign.suites import FOLDER, HALVES, SUITES, load_suite
from sim_bridge.conditions import R1
from task.errors import UserError
from task.state import REFERENCE

COUNT = 10
FLIGHTS = {(s, h): cells(load_suite(s), h, COUNT) for s in SUITES for h in HALVES}


def test_flight_i_is_the_same_however_many_are_flown():
    few = cells(load_suite("hard"), "tuning", 3)
    assert few == [c for c in FLIGHTS["hard", "tuning"] if c.index < 3]


@pytest.mark.parametrize("factor", ["moment", "references", "sensors", "air"])
def test_every_fault_meets_every_level_as_often_as_it_weighs(factor):
    weights = Counter(FACTORS[factor])
    for fault in {c.fault for c in FLIGHTS["hard", "reported"]}:
        met = Counter(getattr(c, factor) for c in FLIGHTS["hard", "reported"] if c.fault == fault)
        assert met == {level: weight * COUNT // len(FACTORS[factor]) for level, weight in weights.items()}


def numbers(half):
    """Return what is drawn in a half: seeds, references, moments, magnitudes of the ranges."""
    flown = [c for s in SUITES for c in FLIGHTS[s, half]]
    weak = [c.flight.faults[0].factor for c in flown if c.fault == "elevator weak"]
    between = [c.flight.condition for c in flown if c.trim == "between"]
    return [{c.flight.seed for c in flown}, {c.seed for c in flown}, set(weak), set(between)]


def test_the_halves_share_no_seed_no_reference_and_no_magnitude():
    for tuning, reported in zip(numbers("tuning"), numbers("reported"), strict=True):
        assert len(tuning) >= COUNT
        assert not tuning & reported
    low, high = 0.3, 0.8
    for half, parity in zip(HALVES, (0, 1), strict=True):
        strata = [int((f - low) / (high - low) * 8) for f in numbers(half)[2]]
        assert {s % 2 for s in strata} == {parity}
        assert len(set(strata)) > 2


def test_a_level_flight_is_level_when_the_fault_comes_and_a_manoeuvre_is_not():
    for cell in FLIGHTS["easy", "tuning"][:40]:
        rows = reference_rows(cell, 0.05)
        k = round(cell.fault_at * 100)
        moved = np.abs(np.gradient(rows[:, : REFERENCE.phi + 1], 0.01, axis=0)).max(axis=1)
        assert EARLIEST <= cell.fault_at <= LATEST
        assert rows.shape == (round(DURATION * 100), 3)
        assert rows[:, REFERENCE.beta].max() == 0.0
        if cell.moment == "level":
            assert rows[k + 50].tolist() == [0.05, 0.0, 0.0]
            assert np.abs(rows[-1500:, REFERENCE.phi]).max() > 0.01
        else:
            assert moved[k - 1 : k + 2].max() == pytest.approx(moved[800:1201].max(), rel=0.05)


def test_times_of_faults_count_from_their_moment_and_a_case_may_fix_its_conditions():
    cell = next(c for c in FLIGHTS["hard", "tuning"] if c.fault == "elevator x -1, repaired after 3 s")
    assert cell.flight.faults[0].start == cell.fault_at
    assert cell.flight.faults[0].end == pytest.approx(cell.fault_at + 3.0)
    second = next(c for c in FLIGHTS["hard", "tuning"] if c.fault == "elevator x -1, aileron x -1 after 0.3 s")
    assert second.flight.faults[1].start == pytest.approx(second.fault_at + 0.3)
    assert {c.flight.condition for c in FLIGHTS["easy", "tuning"] if c.fault.startswith("R1")} == {R1}
    noisy = [c.flight.sensors.noise["q"] for c in FLIGHTS["easy", "tuning"] if c.sensors == "twice the noise"]
    assert noisy[0] == pytest.approx(2.0 * 6.3e-4, rel=0.01)


def test_a_word_picks_a_fault_a_group_or_what_contains_it():
    quick = chosen_cells(SUITES, QUICK, "tuning", 2)
    assert [c.name for c in quick[:2]] == ["none/000", "none/001"]
    assert {c.fault for c in quick} == set(QUICK)
    assert len(quick) == 2 * len(QUICK)
    assert {c.group for c in chosen_cells(SUITES, ("latency",), "tuning", 1)} == {"latency"}
    assert len(chosen_cells(SUITES, ("crossed",), "tuning", 1)) == 1
    assert len(chosen_cells(SUITES, ("elevator x -2", "hardov"), "tuning", 1)) == 4
    with pytest.raises(UserError, match="--fault flap: no such fault; give a part of a name, or a group: none, pub"):
        chosen_cells(SUITES, ("flap",), "tuning", 1)
    with pytest.raises(UserError, match="--fault flap: no such fault"):
        chosen_cells(SUITES, ("crossed", "flap"), "tuning", 1)
    assert quick_faults(["hard"]) == QUICK[2:]
    assert quick_faults(SUITES) == QUICK


def test_a_wrong_suite_is_answered_with_file_and_fault(tmp_path):
    with pytest.raises(UserError, match="--suite harder: no such suite"):
        load_suite("harder")
    file = tmp_path / "s.toml"
    file.write_text('title = "s"\n[[fault]]\nname = "odd"\ngroup = "g"\nfaults = [{kind = "jam", surface = "flap"}]\n')
    with pytest.raises(UserError, match=r"s\.toml: fault 'odd': invalid enum value 'flap'.*choose from elevator"):
        load_suite(str(file))
    file.write_text('title = "s"\n[[fault]]\nname = "odd"\ngroup = "g"\nfaults = [{kind = "jam", start = "a"}]\n')
    with pytest.raises(UserError, match=r"s\.toml: fault 'odd': expected `float`, got `str` - at `\$\[0\]\.start`"):
        load_suite(str(file))
    file.write_text('title = "s"\nfault = []\n')
    with pytest.raises(UserError, match=r"s\.toml: expected `array` of length >= 1, got \[\] - at `\$\.fault`"):
        load_suite(str(file))
    file.write_text('title = "s"\n' + 2 * '[[fault]]\nname = "odd"\ngroup = "g"\n')
    with pytest.raises(UserError, match="fault 'odd' is there twice"):
        load_suite(str(file))


def test_a_suite_counts_once_however_often_it_is_named():
    assert chosen_cells(("hard", "hard"), (), "tuning", 1) == chosen_cells(("hard",), (), "tuning", 1)
    with pytest.raises(UserError, match="another suite is titled 'hard' too"):
        chosen_cells(("hard", str(FOLDER / "hard.toml")), (), "tuning", 1)


def test_no_adaptation_is_flown_alone_when_no_member_is():
    (row,) = choose_rows("none", ())
    assert row.configuration(True).adaptation.switch == "none"
    assert choose_rows("none,oracle", ()) == ["members"]
    assert choose_rows("none,members", ()) == ["members"]
