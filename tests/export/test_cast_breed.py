"""A small cast from nothing: bred, interrupted, resumed, chosen, written."""

import signal

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from export.cast.breed import MAIN, Breeder
from export.cast.cases import Case
from export.cast.choose import tune, write
from export.cast.cli import main
from export.cast.config import CastSettings, SearchSettings, TrialSettings, load
from export.mirrors import AXES
from export.network import Layer
from export.population import load_run
from sim_bridge.faults import Effectiveness, Latency
from task.config import convert
from task.errors import UserError

SEARCH = SearchSettings(population=4, iterations=2, references=1, tuning=1)
SMALL = CastSettings(
    name="small",
    input_scale=(8.0, 8.0, 20.0, 4.0, 4.0, 4.0, 8.0),
    main=SearchSettings(population=4, iterations=2, references=1, tuning=1, rounds=2, symmetric=True),
    specialist=SEARCH,
    robust=SEARCH,
    trial=TrialSettings(duration=0.6, period=2.0, onset=(0.1, 0.3), decision=0.1),
    gains=(1.0, 0.4),
    tuning=1,
    bred_for=("R1",),
    cases=(
        Case(name="elevator x -1", faults=(Effectiveness(surface="elevator", factor=-1.0),)),
        Case(name="latency 100 ms", faults=(Latency(seconds=0.1),)),
    ),
)


def quiet(line, final):
    pass


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cast")
    breeder = Breeder(SMALL, folder)
    assert breeder.breed(quiet)
    assert tune(breeder, quiet)
    write(breeder)
    return breeder


def test_an_interrupted_run_ends_in_the_same_policies(run, tmp_path):
    def after_one():
        left.append(None)
        return len(left) > 1

    for _ in range(20):
        left = []
        if Breeder(SMALL, tmp_path).breed(quiet, after_one):
            break
    resumed = Breeder(SMALL, tmp_path)
    assert resumed.bred.keys() == run.bred.keys()
    for key, one in run.bred.items():
        assert resumed.bred[key].parameters == one.parameters
        assert resumed.bred[key].start == one.start


def test_a_round_goes_on_from_the_last(run):
    assert run.bred[MAIN, 0].start == "random"
    assert run.bred[MAIN, 1].start == "round 1"
    assert all(one.cost <= one.start_cost for one in run.bred.values())


def test_the_run_is_a_population_with_the_main_member_first_and_all_its_mirrors(run):
    population = load_run(run.folder)
    names = [member.name for member in population.description.members]
    assert population.description.champion == names[0] == MAIN
    assert len(AXES) == sum(name.startswith(f"{MAIN}/-") for name in names)
    np.testing.assert_array_equal(population.parameters[0], run.result(MAIN).astype(np.float32))
    training = population.description.training
    assert training["teachers"] == []
    assert training["chosen"]["members"] == names
    assert set(training["chosen"]["for_case"]) == set(run.cases)
    assert set(population.description.members[0].scores) == set(run.cases)
    assert convert(training["config"], CastSettings, "config") == SMALL


def test_what_has_been_compared_is_not_flown_again(run):
    lines = []
    assert tune(run, lambda line, final: lines.append(line))
    assert not lines


def test_other_settings_are_refused(run):
    other = msgspec.structs.replace(SMALL, seed=5)
    with pytest.raises(UserError, match="bred with other settings"):
        Breeder(other, run.folder)


def test_more_rounds_go_on_with_what_is_there(run):
    more = msgspec.structs.replace(SMALL, main=msgspec.structs.replace(SMALL.main, rounds=3))
    assert (MAIN, 1) in Breeder(more, run.folder).bred


def test_a_cast_is_not_chosen_before_everybody_is_bred(tmp_path):
    with pytest.raises(UserError, match="not bred yet: R1, elevator x -1, latency 100 ms, nominal, robust"):
        tune(Breeder(SMALL, tmp_path), quiet)


def test_the_shipped_configuration_loads():
    cast = load("citation")
    assert len(cast.cases) == 33
    assert cast.members <= 50


def test_configurations_are_checked():
    with pytest.raises(UserError, match="no cast 'nobody'; expected one of citation"):
        load("nobody")
    with pytest.raises(ValueError, match="unique names, got nominal twice"):
        CastSettings(name="x", cases=(Case(name="nominal"),))
    with pytest.raises(ValueError, match="expected a network of one layer, got 2"):
        CastSettings(name="x", layers=(Layer(units=4), Layer(units=3)), main=SearchSettings(symmetric=True))
    with pytest.raises(ValueError, match="expected cases of the thesis, got F9"):
        CastSettings(name="x", bred_for=("F9",))
    for last in (
        Layer(units=4),
        Layer(units=3, activation="relu"),
        Layer(units=3, layer_norm="standard"),
    ):
        with pytest.raises(ValueError, match="layers: expected a last layer of 3 units, tanh or linear, without"):
            CastSettings(name="x", layers=(Layer(units=4), last))
    for wrong, said in (
        ({"seed": -1}, "expected `int` >= 0, got -1"),
        ({"trial": {"onset": [5.0, 1.5]}}, r"onset: expected two numbers in order, from 0 on, got \[5, 1\.5\]"),
        ({"trial": {"onset": [2.0, 14.0]}}, "onset: expected it before the end at 14 s, got 14"),
        ({"randomised": {"effectiveness": [0.0, 1.0]}}, "effectiveness: expected two numbers in order, from 0.01 on"),
        ({"main": {"sigma": float("inf")}}, "expected a finite number, got inf"),
    ):
        with pytest.raises(UserError, match=said):
            convert({"name": "x"} | wrong, CastSettings, "mine.toml")


@pytest.mark.parametrize(("minutes", "code"), [([], 130), (["--minutes", "0"], 3)])
def test_who_stops_a_run_is_told_how_to_go_on(minutes, code, tmp_path, monkeypatch):
    def stopped(self, report, stop):
        if not minutes:
            signal.raise_signal(signal.SIGINT)
        return not stop()

    monkeypatch.setattr(Breeder, "breed", stopped)
    before = signal.getsignal(signal.SIGINT)
    try:
        done = CliRunner().invoke(main, ["breed", "--out", str(tmp_path / "run"), *minutes])
    finally:
        signal.signal(signal.SIGINT, before)
    assert done.exit_code == code
    assert "the same command goes on" in done.output


def test_a_run_goes_on_with_its_own_configuration(tmp_path):
    config = tmp_path / "config.toml"
    config.write_text('name = "own"')
    for _ in range(2):
        done = CliRunner().invoke(main, ["breed", "--config", str(config), "--out", str(tmp_path), "--minutes", "0"])
        assert done.exit_code == 3, done.output
    assert config.read_text() == 'name = "own"'


def test_cases_whose_files_would_be_one_are_refused(tmp_path):
    cases = tuple(Case(name=name) for name in ("rudder -1", "rudder_-1"))
    with pytest.raises(UserError, match="got rudder -1 and rudder_-1; rename one"):
        Breeder(msgspec.structs.replace(SMALL, cases=cases), tmp_path)


def test_a_network_that_cannot_fly_is_not_bred(tmp_path):
    layers = (Layer(units=0), *SMALL.layers)
    settings = msgspec.structs.replace(SMALL, layers=layers, main=SearchSettings(population=4), input_scale=(1.0,) * 7)
    with pytest.raises(UserError, match=r"small: network.layers\[0\].units: expected at least 1"):
        Breeder(settings, tmp_path / "run")
    assert not any(tmp_path.iterdir())
