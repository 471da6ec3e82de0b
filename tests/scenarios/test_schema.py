"""Scenarios are read strictly, and what is wrong with one is said in a line."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest

from runtime.reference import load_reference
from scenarios.references import build, csv_bytes, read, with_count
from scenarios.schema import CHOICES, MODES, References, Scenario, available, find, load_scenario, to_toml
from sim_bridge.air import Air
from sim_bridge.conditions import FlightCondition
from sim_bridge.faults import AnyFault
from sim_bridge.flight import Flight
from sim_bridge.sensors import SensorSettings
from task.errors import UserError
from task.reference import FAMILIES
from task.state import REFERENCE


def scenario_file(folder: Path, text: str) -> Path:
    path = folder / "some.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('title = "t"\nmode = ["none"]', r"some\.toml: .*unknown field `mode`.*known keys: title, .*modes"),
        ('title = "t"\n[flight]\nlength = 3.0', r"some\.toml: .*unknown field `length`.*`\$\.flight`.*duration"),
        (
            'title = "t"\n[flight.condition]\nspeed = "fast"',
            r"some\.toml: expected `float`, got `str`.*condition\.speed",
        ),
        (
            'title = "t"\n[flight]\nduration = -1.0',
            r"some\.toml: expected `float` >= 0\.01 \[s\], got -1.*duration",
        ),
        (
            'title = "t"\n[[flight.faults]]\nkind = "jam"\nsurface = "rudder"\nangle_deg = 99',
            r"expected `float` <= 30\.0 \[deg\], got 99 - at `\$\.flight\.faults\[0\]\.angle_deg`",
        ),
        ('title = "t"\n[references]\nfamily = "wild"', r"some\.toml: .*'wild'.*references\.family"),
        ('title = "t"\n[references]\nsource = "file"', r"some\.toml: references\.file: expected a CSV or NPY file"),
        ('title = "t"\n[references]\nsource = "random"\nseeds = []', r"some\.toml: references\.seeds: .*at least one"),
        ('title = "t"\n[references]\nsource = "random"\nseeds = [3, 3]', r"references\.seeds: .*once, got 3, 3"),
        ('title = "t"\n[references]\nfile = "r.csv"', r"references\.file: expected with source = 'file' alone"),
        ('title = "t"\n[references]\nseeds = [1]', r"references\.seeds: .*source = 'random' alone, .* 'base'"),
        ('title = "t"\n[references]\nfamily = "evaluation"', r"references\.family: .*source = 'random' alone"),
        ('title = "t"\n[references]\nsource = "file"\nfile = "r.csv"\nseeds = [1]', r"references\.seeds: .*'file'"),
        (
            'title = "t"\n[flight]\nduration = 10.0\n[[flight.faults]]\nkind = "crossed"\nstart = 10.0',
            r"some\.toml: flight\.faults\[0\]\.start: expected less than .* 10 s, got 10 s .*begin earlier",
        ),
        ('title = "t"\n[flight.condition]\nheading = 270.0', r"some\.toml: .*flight\.condition\.heading"),
        ('title = "t"\n[flight.air]\nwind_north = nan', r"some\.toml: .*flight\.air\.wind_north"),
        ('title = "t"\n[flight.sensors.bias]\nq = nan', r"some\.toml: bias\.q: expected .* 5 rad/s.*flight\.sensors"),
        ('title = "t"\nmodes = ["none", "magic"]', r"some\.toml: .*'magic'.*modes"),
        ('title = "t"\nmodes = ["none", "none"]', r"some\.toml: modes: expected each mode once"),
        ('title = "t"\nmodes = []', r"some\.toml: modes: expected at least one"),
        ('description = "no title"', r"some\.toml: .*missing required field `title`"),
        ("title = ", r"some\.toml: not valid TOML"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_key(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(UserError, match=line) as caught:
        load_scenario(scenario_file(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_the_page_of_scenarios_knows_every_key(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "scenarios.md").read_text()
    example = text.split("```toml\n")[1].split("```")[0]
    assert load_scenario(scenario_file(tmp_path, example)).flight.faults
    structs = (Scenario, References, Flight, FlightCondition, Air, SensorSettings, *get_args(AnyFault))
    keys = {field.encode_name for struct in structs for field in msgspec.structs.fields(struct)}
    keys |= {str(kind.__struct_config__.tag) for kind in get_args(AnyFault)} | set(CHOICES) | set(FAMILIES)
    containers = {"flight", "references", "condition", "air", "sensors", "noise"}
    said = set(re.findall(r"[\w-]+", " ".join(re.findall(r"`([^`\n]+)`", text))))
    assert keys - containers <= said


def test_a_scenario_that_is_not_there() -> None:
    with pytest.raises(UserError, match=r"scenario 'cg_shfit': no such scenario; choose one of .*\.toml file"):
        find("cg_shfit")
    with pytest.raises(UserError, match=r"nowhere\.toml: no such scenario"):
        load_scenario(find("nowhere.toml"))


@pytest.mark.parametrize("path", available().values(), ids=available())
def test_every_shipped_scenario_reads_and_says_what_it_verifies(path: Path) -> None:
    scenario = load_scenario(path)
    assert scenario.title
    assert scenario.description
    comments = [line for line in path.read_text().splitlines() if line.startswith("#")]
    heads = [line.lstrip("# ").split("|")[0].strip() for line in comments]
    assert [head for head in heads if head][:1] == ["Verifies"]
    assert {"Verifies", "Atmosphere", "Vehicle", "Notes"} <= set(heads)


def test_a_flight_written_as_toml_reads_back_the_same() -> None:
    flight = Flight(duration=1e-2, condition=FlightCondition(flight_path=-math.pi / 60, heading=1.25e-7), seed=7)
    assert msgspec.convert(tomllib.loads(to_toml(flight)), Flight) == flight


@pytest.mark.parametrize("path", available().values(), ids=available())
def test_every_shipped_scenario_survives_toml(path: Path) -> None:
    scenario = load_scenario(path)
    assert msgspec.convert(tomllib.loads(to_toml(scenario)), Scenario) == scenario
    assert msgspec.convert(tomllib.loads(to_toml(scenario.flight)), Flight) == scenario.flight


def test_the_modes_are_the_two_presets_and_their_ways_to_switch() -> None:
    assert list(MODES) == ["none", "thesis-hard", "thesis-soft", "understudy-hard", "understudy-soft"]
    assert all(mode.name in {"none", f"{mode.preset}-{mode.switch}"} for mode in MODES.values())


def test_references_are_drawn_about_trim_and_each_seed_is_another() -> None:
    scenario = Scenario(title="t", flight=Flight(duration=20.0), references=with_count(References(), 3))
    first, second, third = build(scenario, Path())
    assert [r.name for r in (first, second, third)] == ["evaluation-1", "evaluation-2", "evaluation-3"]
    trim = build(Scenario(title="t", flight=Flight(duration=20.0)), Path())[0].rows[0, REFERENCE.theta]
    assert first.rows.shape == (2000, 3)
    assert first.rows[0, REFERENCE.theta] == trim != 0.0
    assert not np.array_equal(first.rows, second.rows)
    again = build(scenario, Path())
    assert np.array_equal(first.rows, again[0].rows)


def test_more_references_follow_the_seeds_given() -> None:
    assert with_count(References(seeds=(4, 9)), 4).seeds == (4, 9, 10, 11)
    assert with_count(References(seeds=(4, 9)), 1).seeds == (4,)


def test_a_reference_file_is_exact_and_the_runtime_reads_the_same(tmp_path: Path) -> None:
    rows = build(Scenario(title="t", flight=Flight(duration=20.0)), Path())[0].rows
    path = tmp_path / "reference.csv"
    path.write_bytes(csv_bytes(rows))
    np.testing.assert_allclose(read(path, len(rows)), rows, rtol=0, atol=1e-12)
    np.testing.assert_allclose(load_reference(path).preview(0.0, len(rows)), rows, rtol=0, atol=1e-7)
    scenario = Scenario(
        title="t", flight=Flight(duration=20.0), references=References(source="file", file="reference.csv")
    )
    (built,) = build(scenario, tmp_path)
    assert built.name == "reference"
    np.testing.assert_allclose(built.rows, rows, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("t,theta,phi,beta\n0,0,0\n", "row 1: expected 4 numbers, got 3"),
        ("t,theta,phi,beta\n0,0,0,nan\n", "row 1 is not finite"),
        ("", "bad.csv: expected shape"),
        ("0,0,0,0\n0,0,0,0\n", "time must rise"),
        ("-2,0,0,0\n-1,0,0,0\n", "expected the last row between t = 0 s"),
        ("0,0,0,0\n1,12,0,0\n", "are these degrees"),
    ],
)
def test_a_bad_reference_file_is_one_line(tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(UserError, match=line):
        read(path, 10)


def test_a_reference_file_may_be_whatever_the_runtime_reads(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("# by hand\n0, 0.1, 0, 0\n0.02, 0.3, 0, 0\n")
    np.testing.assert_allclose(read(tmp_path / "r.csv", 4)[:, REFERENCE.theta], [0.1, 0.2, 0.3, 0.3])
    np.save(tmp_path / "r.npy", [[0.0, 0.1, 0.0, 0.0], [0.02, 0.3, 0.0, 0.0]])
    assert (read(tmp_path / "r.npy", 4) == read(tmp_path / "r.csv", 4)).all()


def test_a_bare_name_is_the_shipped_scenario_whatever_lies_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "nominal").mkdir()
    (tmp_path / "mine").mkdir()
    assert find("nominal") == available()["nominal"]
    with pytest.raises(UserError, match="scenario 'mine': no such scenario"):
        find("mine")
