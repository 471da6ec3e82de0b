"""Trained runs: what is read, what is refused and how; the command from run to population."""

from __future__ import annotations

import json

import click.testing
import numpy as np
import pytest

from export.cli import export
from export.network import Layer, Network, flatten, layout, n_parameters, unflatten, validate
from export.population import load_run, save_run
from task.errors import UserError

NETWORK = Network(layers=(Layer(units=8), Layer(units=8, layer_norm="unbiased"), Layer(units=3)))


@pytest.fixture
def run(tmp_path, make_actors):
    folder = tmp_path / "run"
    save_run(make_actors(NETWORK), folder)
    return folder


def edit(folder, **changes):
    path = folder / "population.json"
    data = json.loads(path.read_bytes())
    data.update(changes)
    path.write_text(json.dumps(data))


def test_a_run_comes_back_as_it_was_saved(run, make_actors):
    loaded, original = load_run(run), make_actors(NETWORK)
    assert loaded.description == original.description
    np.testing.assert_array_equal(loaded.parameters, original.parameters)


def test_flat_parameters_and_tensors_are_the_same(make_actors):
    population = make_actors(NETWORK)
    tensors = unflatten(NETWORK, population.parameters)
    np.testing.assert_array_equal(flatten(NETWORK, tensors), population.parameters)
    assert list(tensors) == [t.name for t in layout(NETWORK)]
    assert tensors["layers.1.weight"].shape == (4, 8, 8)
    assert n_parameters(NETWORK) == 7 * 8 + 8 + 8 * 8 + 3 * 8 + 8 * 3 + 3


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "population.json").unlink(), "population.json: no such description"),
        (lambda f: (f / "parameters.npy").unlink(), "parameters.npy: no such parameters"),
        (lambda f: (f / "population.json").write_text("{"), "population.json: not valid JSON"),
        (lambda f: (f / "parameters.npy").write_bytes(b"\x93NUMPY"), "parameters.npy: not a plain .npy array"),
        (lambda f: edit(f, colour="red"), "unknown field `colour`"),
        (lambda f: edit(f, champion="nobody"), "champion: expected a member's name, got 'nobody'"),
        (lambda f: edit(f, members=[]), "members: expected at least one"),
        (lambda f: edit(f, members=[{"name": "a"}] * 2), r"members: expected .* unique names, got \['a'\]$"),
        (lambda f: edit(f, members=[{"name": ""}]), "members: expected names in one line of printable text, got ''"),
        (lambda f: edit(f, members=[{"name": "a\nb"}]), r"members: expected names in one line .*, got 'a\\nb'"),
        (lambda f: edit(f, members=[{"name": "a"}], champion="a"), r"expected float32 \(1, 179\)"),
        (lambda f: np.save(f / "parameters.npy", np.zeros((4, 179))), r"got float64 \(4, 179\)"),
        (lambda f: np.save(f / "parameters.npy", np.full((4, 179), np.nan, np.float32)), "'actor-0' are not finite"),
        (
            lambda f: np.save(f / "parameters.npy", np.array([{}]), allow_pickle=True),
            "parameters.npy: not a plain .npy array",
        ),
        (
            lambda f: edit(f, parameters=[{"name": "layers.0.bias", "shape": [8], "offset": 0}]),
            "parameters: expected the layout of the network",
        ),
        (lambda f: edit(f, network={"layers": [{"units": 4}]}), r"layers\[-1\].units: expected 3"),
    ],
)
def test_what_is_wrong_with_a_run_is_said_in_one_line(run, spoil, message):
    spoil(run)
    with pytest.raises(UserError, match=message) as caught:
        load_run(run)
    assert "\n" not in str(caught.value)
    assert str(run) in str(caught.value)


def test_a_missing_run_is_named(tmp_path):
    with pytest.raises(UserError, match="no such trained run; train one"):
        load_run(tmp_path / "nothing")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layers": ()}, "layers: expected at least the output layer"),
        (
            {"layers": (Layer(units=1, layer_norm="unbiased"), Layer(units=3))},
            r"layers\[0\].units: expected at least 2",
        ),
        ({"observation": 8}, "observation: expected the task's 7"),
        ({"input_scale": (1.0,)}, "input_scale: expected 7 finite numbers"),
        ({"action_offset": (0.0, 0.0, float("nan"))}, "action_offset: expected 3 finite"),
        ({"layer_norm_eps": 0.0}, "layer_norm_eps: expected a positive number"),
    ],
)
def test_a_network_that_cannot_fly_is_refused(changes, message):
    with pytest.raises(UserError, match=message):
        validate(Network(**({"layers": NETWORK.layers} | changes)), "here")


def test_stacked_tensors_of_the_wrong_shape_are_refused(make_actors):
    tensors = dict(unflatten(NETWORK, make_actors(NETWORK).parameters))
    with pytest.raises(UserError, match=r"layers\.0\.bias: expected"):
        flatten(NETWORK, tensors | {"layers.0.bias": np.zeros((4, 9))})
    with pytest.raises(UserError, match=r"missing or unknown: \['layers\.9\.bias'\]"):
        flatten(NETWORK, tensors | {"layers.9.bias": np.zeros((4, 9))})


def test_the_command_exports_a_run_with_its_training_records(run, tmp_path):
    (run / "config.toml").write_text("seed = 1\n")
    (run / "learning_curve.csv").write_text("frames,return\n")
    settings = tmp_path / "prior.toml"
    settings.write_text("flights = 1\nduration = 10.0\n")
    target = tmp_path / "populations" / "cast"
    arguments = [str(run), str(target), "--prior", str(settings), "--no-screening"]
    result = click.testing.CliRunner().invoke(export, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert "verified against its golden samples" in result.output
    manifest = json.loads((target / "manifest.json").read_bytes())
    assert manifest["name"] == "cast"
    assert {"MODEL_CARD.md", "training/config.toml", "training/learning_curve.csv"} <= set(manifest["files"])
    assert (target / "training" / "config.toml").read_text() == "seed = 1\n"
    assert "Not screened" in (target / "MODEL_CARD.md").read_text()


def test_the_command_refuses_unknown_prior_settings(run, tmp_path):
    settings = tmp_path / "prior.toml"
    settings.write_text("flight = 1\n")
    with pytest.raises(UserError, match=r"unknown field `flight`.*known keys: conditions, flights"):
        click.testing.CliRunner().invoke(
            export, [str(run), str(tmp_path / "out"), "--prior", str(settings)], catch_exceptions=False
        )
    assert not (tmp_path / "out").exists()


def test_the_command_says_before_its_flights_that_it_cannot_write(run):
    with pytest.raises(UserError, match="/proc/x: /proc: cannot be written"):
        click.testing.CliRunner().invoke(export, [str(run), "/proc/x"], catch_exceptions=False)


def test_a_run_that_is_cut_short_while_it_is_written_is_not_taken_for_one(run, make_actors, monkeypatch):
    """The old description must not stand beside new parameters."""

    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(UserError, match=r"parameters\.npy: cannot be written: No space left on device"):
        save_run(make_actors(NETWORK, seed=3), run)
    monkeypatch.undo()
    with pytest.raises(UserError, match=r"population\.json: no such description"):
        load_run(run)
    save_run(make_actors(NETWORK, seed=3), run)
    np.testing.assert_array_equal(load_run(run).parameters, make_actors(NETWORK, seed=3).parameters)


def test_the_command_says_before_its_flights_whom_single_precision_does_not_fly(run, tmp_path):
    np.save(run / "parameters.npy", np.load(run / "parameters.npy") * np.float32(1e30))
    out = tmp_path / "cast"
    result = click.testing.CliRunner().invoke(export, [str(run), str(out)])
    assert isinstance(result.exception, UserError)
    assert "member 'actor-0': in single precision" in str(result.exception)
    assert "model prior" not in result.output
    assert not out.exists()
