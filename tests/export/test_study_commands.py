"""The study's commands on tiny runs: what they write is what was flown, and a second start flies nothing again."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from export.network import Layer, Network, flatten, layout
from export.population import Description, Member, Population, save_run
from export.study import short
from export.study.command import study
from export.study.generation import VARIANTS, mutated
from export.study.ranges import RANGES, configure
from export.study.short_runs import OPERATORS, operator, smooth_fitness, td3, without_caps
from export.study.sweep_picture import place
from export.study.thesis import TABLE_71
from export.training.evaluate import evaluation_references
from task import results
from task.errors import UserError
from task.state import ACTION, OBSERVATION

NETWORK = Network(layers=(Layer(units=3),))


def laws(*gains: float) -> np.ndarray:
    """Return linear laws (P, K) about trim; the larger the gain, the tighter they track."""
    tensors = {t.name: np.zeros((len(gains), *t.shape), dtype=np.float32) for t in layout(NETWORK)}
    weight, bias = tensors["layers.0.weight"], tensors["layers.0.bias"]
    bias[:, ACTION.de] = np.arctanh(-1.43 / 10.0)
    for i, gain in enumerate(gains):
        weight[i, ACTION.de, [OBSERVATION.theta_e, OBSERVATION.q]] = -gain, 0.4 * gain
        weight[i, ACTION.da, [OBSERVATION.phi_e, OBSERVATION.p]] = -gain, 0.4 * gain
    return flatten(NETWORK, tensors)


def saved(folder, champion, **gains):
    members = tuple(Member(name=name, scores={"validation_nmae": 10.0 / gain}) for name, gain in gains.items())
    description = Description(network=NETWORK, members=members, champion=champion)
    save_run(Population(description, laws(*gains.values())), folder)
    return folder


@pytest.fixture
def quick(monkeypatch):
    """Make short runs very short and very small, and their last flights too."""
    real = short.varied

    def varied(*arguments, **changes):
        config = real(*arguments, **changes)
        actor = msgspec.structs.replace(config.actor, width=8, hidden=1)
        genetic = msgspec.structs.replace(config.genetic, population=min(config.genetic.population, 4), memory=500)
        task = msgspec.structs.replace(config.task, duration=2.0)
        return msgspec.structs.replace(config, frames=1500, actor=actor, genetic=genetic, task=task)

    monkeypatch.setattr("export.study.short_runs.varied", varied)
    monkeypatch.setattr("export.study.generation.DURATION", 2.0)
    monkeypatch.setattr(
        "export.training.run.evaluation_references", lambda *arguments: evaluation_references(*arguments, duration=2.0)
    )


def invoke(*arguments):
    result = CliRunner().invoke(study, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_table71_tells_champion_average_and_td3_apart(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = saved(tmp_path / "cast", "actor_0", actor_0=8.0, actor_1=20.0, td3=0.5)
    rival, weak = saved(tmp_path / "alone", "td3", td3=2.0), saved(tmp_path / "weak", "td3", td3=0.2)
    arguments = ["table71", run, "--td3", weak, "--td3", rival, "--references", 3, "--population-references", 2]
    arguments += ["--cases", "nominal,F6", "--duration", 10]
    invoke(*arguments)
    result = results.read(tmp_path / "results" / "table71.json")
    table = {t.title.split(",")[0].split(" without")[0]: t for t in result.tables}
    nominal, jammed = table["nMAE [%]"].rows
    assert nominal[0] == "nominal"
    assert nominal[1] == str(TABLE_71["nominal"].td3) == "7.43 ± 1.6"
    ours = {name: float(nominal[i].split()[0]) for name, i in (("td3", 2), ("average", 4), ("champion", 7))}
    assert ours["champion"] < ours["td3"]
    assert nominal[8].endswith("actor_1")
    assert float(nominal[8].split()[0]) < ours["champion"]
    assert ours["champion"] == pytest.approx(float(result.claims[0].value), abs=0.01)
    assert float(jammed[7].split()[0]) > ours["champion"]
    assert [row[0] for row in table["TD3 actors"].rows] == [str(weak), str(rival), f"within {run.name}"]
    assert table["F6"].rows[2][3] > 1.0
    assert table["Significance"].columns[-1].startswith("champion less TD3")
    assert (tmp_path / "docs" / "img" / "table71.png").stat().st_size > 5000
    kept = sorted((p, p.stat().st_mtime_ns) for p in tmp_path.rglob("study/*.npz"))
    invoke(*arguments)
    assert sorted((p, p.stat().st_mtime_ns) for p in tmp_path.rglob("study/*.npz")) == kept


def test_table71_without_a_td3_actor_says_so(tmp_path):
    run = saved(tmp_path / "cast", "a", a=4.0)
    with pytest.raises(UserError, match="no member 'td3'; name a run of TD3 alone with --td3"):
        CliRunner().invoke(study, ["table71", str(run)], catch_exceptions=False)


def test_mutation_study_from_training_to_pictures(tmp_path, monkeypatch, quick):
    monkeypatch.chdir(tmp_path)
    invoke("mutation", "--seeds", 1, "--references", 2)
    result = results.read(tmp_path / "results" / "mutation.json")
    over_training, generation, tests = result.tables
    assert [row[0] for row in over_training.rows] == list(OPERATORS)
    assert [row[0] for row in generation.rows] == list(VARIANTS) * 3
    steps = [row[2] for row in generation.rows if row[0] == "gaussian"]
    assert steps == sorted(steps)
    assert steps[0] > 0.0
    assert len(tests.rows) == 15
    for picture in ("mutation_training", "mutation_generation"):
        assert (tmp_path / "docs" / "img" / f"{picture}.png").stat().st_size > 5000
    folder = tmp_path / "runs" / "study" / "serl10-safe-1"
    before = (folder / "checkpoint.npz").stat().st_mtime_ns
    again = short.train(operator("safe", 1), lambda row: None)
    assert (folder / "checkpoint.npz").stat().st_mtime_ns == before
    assert again.curve[-1].frames >= 1500
    children, step, informed = mutated(again, again_network(folder), "safe", 0.0)
    np.testing.assert_array_equal(children, short.memories(again)["parameters"].numpy())
    assert not step.any()
    assert 0 <= informed <= 4


def again_network(folder):
    from export.population import load_run

    return load_run(folder).network


def test_a_short_run_of_other_settings_is_refused(tmp_path, quick):
    config = operator("safe", 3)
    short.train(config, lambda row: None, tmp_path)
    other = msgspec.structs.replace(config, genetic=msgspec.structs.replace(config.genetic, elite_fraction=0.5))
    with pytest.raises(UserError, match=r"another genetic\.elite_fraction than the study has now; remove it"):
        short.train(other, lambda row: None, tmp_path)


def test_short_runs_differ_in_what_they_compare_alone():
    base = operator("safe", 1)
    assert base.td3.lambda_s > 0.0
    assert not base.genetic.smooth_fitness
    assert smooth_fitness(1).genetic == msgspec.structs.replace(base.genetic, smooth_fitness=True)
    assert without_caps(1).td3 == msgspec.structs.replace(base.td3, lambda_s=0.0, lambda_t=0.0)
    assert without_caps(1).genetic == base.genetic
    assert td3(True, 1).genetic.population == 0
    assert td3(False, 1).td3.lambda_t == 0.0 < td3(True, 1).td3.lambda_t


def test_sweep_goes_on_where_it_was_and_draws_every_trial(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ("sweep", "--frames", 1, "--kind", "td3", "--trials")
    invoke(*arguments, 2)
    first = results.read(tmp_path / "results" / "sweep.json")
    invoke(*arguments, 3)
    result = results.read(tmp_path / "results" / "sweep.json")
    trials = {row[0]: row for row in result.tables[0].rows}
    assert sorted(trials) == [0, 1, 2]
    assert all(row in result.tables[0].rows for row in first.tables[0].rows)
    assert [row[0] for row in result.tables[1].rows] == [r.name for r in RANGES["td3"]]
    assert trials[0][3:] == [r.thesis for r in RANGES["td3"]]
    assert len({row[3] for row in trials.values()}) == 3
    assert (tmp_path / "docs" / "img" / "sweep.png").stat().st_size > 5000


@pytest.mark.parametrize("kind", list(RANGES))
def test_thesis_values_lie_on_every_axis_and_make_a_configuration(kind):
    values = {r.name: r.thesis for r in RANGES[kind]}
    assert all(0.0 <= place(r, r.thesis) <= 1.0 for r in RANGES[kind])
    config = configure(kind, values, 1000, 1)
    assert config.frames == 1000
    for name, value in values.items():
        table, field = name.split(".")
        assert getattr(getattr(config, table), field) == value


def test_curves_and_smoothness_read_finished_runs(tmp_path, monkeypatch, quick):
    monkeypatch.chdir(tmp_path)
    run = short.train(operator("safe", 1), lambda row: None).folder
    invoke("curves", run)
    final, milestones = results.read(tmp_path / "results" / "curves.json").tables
    assert final.rows[2][0] == milestones.rows[0][0] == "serl10-safe-1"
    invoke("smoothness", run)
    points = results.read(tmp_path / "results" / "smoothness.json").tables[0].rows
    by_name = {row[0]: row for row in points}
    assert by_name["serl10-smooth-1"][2] == "yes"
    assert by_name["td3-nocaps-1"][1] == "no"
    assert by_name["td3-caps-1"][1] == "yes"
    for picture in ("curves", "smoothness", "smoothness_spread"):
        assert (tmp_path / "docs" / "img" / f"{picture}.png").stat().st_size > 5000


def test_a_folder_without_a_curve_is_named(tmp_path):
    with pytest.raises(UserError, match=r"learning_curve\.csv: no learning curve of a training run"):
        short.read_curve(tmp_path)


@pytest.mark.parametrize(
    ("members", "arguments", "message"),
    [
        ({"td3": 1.0}, ["table71", "cast"], "cast: no genetic actors; expected a population"),
        ({"a": 4.0, "td3": 1.0}, ["table71", "cast", "--td3", "cast"], "--td3 cast: is the population itself"),
        ({"a": 4.0}, ["curves", "cast"], "cast: no member 'td3'; expected a run of 'understudy train'"),
    ],
)
def test_a_run_that_lacks_who_is_compared_is_named(members, arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    saved(tmp_path / "cast", next(iter(members)), **members)
    with pytest.raises(UserError, match=message):
        CliRunner().invoke(study, arguments, catch_exceptions=False)
