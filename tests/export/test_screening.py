"""Screening: what is seen of members of known skill, and what manifest and card say of it."""

from __future__ import annotations

import json

import click.testing
import numpy as np
import pytest
from msgspec.structs import replace

from export.card import card
from export.cli import export
from export.network import Layer, Network, flatten, layout
from export.population import Description, Member, Population, save_run
from export.screening import SCREENED, Screening, ScreeningSettings, annotated, fit, flights, screen
from runtime.population import load_population
from task.errors import UserError
from task.state import ACTION, OBSERVATION

NETWORK = Network(layers=(Layer(units=3),))
QUICK = ScreeningSettings(references=1, duration=6.0)
HARD_OVER, TRACKS, IDLE, MIRROR = 0, 1, 2, 3


def cast() -> Population:
    """Return one-layer members: hard over, a linear law, one that holds near trim, the law with elevator reversed."""
    tensors = {t.name: np.zeros((4, *t.shape), dtype=np.float32) for t in layout(NETWORK)}
    weight, bias = tensors["layers.0.weight"], tensors["layers.0.bias"]
    bias[HARD_OVER] = 9.0
    bias[[TRACKS, IDLE], ACTION.de] = np.arctanh(-1.43 / 10.0)
    weight[TRACKS, ACTION.de, [OBSERVATION.theta_e, OBSERVATION.q]] = -6.0, 3.0
    weight[TRACKS, ACTION.da, [OBSERVATION.phi_e, OBSERVATION.p]] = -6.0, 3.0
    for tensor in (weight, bias):
        tensor[MIRROR] = tensor[TRACKS]
        tensor[MIRROR, ACTION.de] *= -1.0
    names = ("hard_over", "tracks", "idle", "mirror")
    members = tuple(Member(name=name, scores={"own": 1.0}) for name in names)
    description = Description(network=NETWORK, members=members, champion="tracks", training={"seed": 5, "teachers": []})
    return Population(description, flatten(NETWORK, tensors))


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> Screening:
    store = tmp_path_factory.mktemp("run") / "study"
    done: list[int] = []
    screening = screen(cast(), QUICK, store, done.append)
    assert sum(done) == flights(cast(), QUICK) == 4 * len(SCREENED)
    assert len(list(store.iterdir())) == len(SCREENED)
    return screening


def test_members_of_known_skill_are_told_apart(seen):
    assert list(seen.scores) == [case.name for case in SCREENED]
    assert seen.passed(HARD_OVER) == 0
    assert seen.verdict(HARD_OVER).startswith("fails in every case")
    assert seen.breaches(TRACKS, "nominal") == []
    assert seen.passed(TRACKS) > seen.passed(MIRROR)
    assert seen.breaches(MIRROR, "elevator_reversed") == []
    assert "loses 1 of 1" in seen.breaches(TRACKS, "elevator_reversed")
    assert seen.scores["nominal"].nmae[TRACKS, 0] < 0.5 * seen.scores["nominal"].nmae[HARD_OVER, 0]


def test_each_constraint_is_named_when_it_is_broken(seen):
    words = " ".join(seen.breaches(HARD_OVER, "nominal"))
    assert "saturated 100 %" in words
    strict = seen._replace(settings=ScreeningSettings(references=1, duration=6.0, error=1e-3))
    assert "tracks with" in " ".join(strict.breaches(TRACKS, "nominal"))
    assert strict.verdict(TRACKS).startswith("fails")


def test_scores_go_beside_those_of_the_run(seen):
    population = annotated(cast(), seen)
    scores = population.description.members[TRACKS].scores
    assert scores["own"] == 1.0
    assert scores["screening_nominal_nmae"] == pytest.approx(seen.scores["nominal"].nmae[TRACKS].mean(), rel=1e-3)
    assert scores["screening_cases_passed"] == seen.passed(TRACKS)
    assert population.description.training["screening"]["verdicts"]["hard_over"] == seen.verdict(HARD_OVER)
    assert population.description.training["seed"] == 5


def test_who_keeps_the_constraints_in_no_case_is_left_out_when_asked_for(seen):
    population, screening, left_out = fit(cast(), seen)
    names = [member.name for member in population.description.members]
    assert names == [name for i, name in enumerate(("hard_over", "tracks", "idle", "mirror")) if seen.passed(i)]
    assert "hard_over" in left_out
    assert left_out["hard_over"] == seen.verdict(HARD_OVER)
    tracks = names.index("tracks")
    np.testing.assert_array_equal(population.parameters[tracks], cast().parameters[TRACKS])
    assert screening.verdict(tracks) == seen.verdict(TRACKS)
    fitting = annotated(population, screening, left_out)
    said = fitting.description.training["screening"]
    assert said["left_out"] == left_out
    assert set(said["verdicts"]) == set(names)
    assert f"broken aircraft:\n{', '.join(left_out)}." in card(fitting, "fitting", {}, screening)
    assert "Nobody is removed" in card(annotated(cast(), seen), "all", {}, seen)
    worst = cast().description
    with pytest.raises(UserError, match="hard_over: keeps the safety constraints in no case"):
        fit(Population(replace(worst, champion="hard_over"), cast().parameters), seen)


def test_the_command_writes_a_card_and_the_runtime_reads_the_folder(tmp_path):
    save_run(cast(), tmp_path / "run")
    (tmp_path / "prior.toml").write_text("flights = 1\nduration = 10.0\n")
    (tmp_path / "screening.toml").write_text("references = 1\nduration = 2.0\n")
    target = tmp_path / "four"
    arguments = [str(tmp_path / "run"), str(target), "--prior", str(tmp_path / "prior.toml")]
    arguments += ["--screening", str(tmp_path / "screening.toml")]
    result = click.testing.CliRunner().invoke(export, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    written = (target / "MODEL_CARD.md").read_text()
    for text in ("# four", "4 flight policies", "Champion: **tracks**", "| hard_over | 0 |", "none: from scratch"):
        assert text in written
    assert max(map(len, written.splitlines())) < 1000
    loaded = load_population(target)
    assert loaded.manifest.members[TRACKS].scores["screening_lost"] >= 0.0
    manifest = json.loads((target / "manifest.json").read_bytes())
    assert "MODEL_CARD.md" in manifest["files"]
    assert set(manifest["training"]["screening"]["verdicts"]) == {"hard_over", "tracks", "idle", "mirror"}


def test_who_is_fit_is_not_known_without_a_screening(tmp_path):
    save_run(cast(), tmp_path / "run")
    arguments = [str(tmp_path / "run"), str(tmp_path / "out"), "--only-fit", "--no-screening"]
    with pytest.raises(UserError, match="--only-fit: who is fit is what the screening says"):
        click.testing.CliRunner().invoke(export, arguments, catch_exceptions=False)


def test_settings_that_mean_nothing_are_refused_before_anything_is_flown(tmp_path):
    save_run(cast(), tmp_path / "run")
    (tmp_path / "screening.toml").write_text("references = 0\n")
    arguments = [str(tmp_path / "run"), str(tmp_path / "out"), "--screening", str(tmp_path / "screening.toml")]
    with pytest.raises(UserError, match="references"):
        click.testing.CliRunner().invoke(export, arguments, catch_exceptions=False)


def test_flights_that_are_damaged_are_named(tmp_path):
    screen(cast(), QUICK, tmp_path, lambda done: None)
    spoilt = sorted(tmp_path.iterdir())[0]
    spoilt.write_bytes(spoilt.read_bytes()[:200])
    with pytest.raises(UserError, match=rf"{spoilt.name}: holds no flights; delete it"):
        screen(cast(), QUICK, tmp_path, lambda done: None)


def test_a_name_with_a_bar_in_it_stays_in_its_column(seen):
    renamed = cast()
    members = tuple(replace(member, name=f"a|{member.name}") for member in renamed.description.members)
    renamed = renamed._replace(description=replace(renamed.description, members=members, champion="a|tracks"))
    rows = [line for line in card(renamed, "four", {}, seen).splitlines() if "a\\|" in line or "a|" in line]
    assert len(rows) > len(members)
    assert all("a|" not in row for row in rows if row.startswith("|"))
