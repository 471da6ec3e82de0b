"""The folder that is written: whole, self-describing, equal each time, never half."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import onnx
import pytest

from export import folder as folder_module
from export.folder import check_place, write_population
from export.golden import GOLDEN_OBSERVATIONS, golden_actions
from export.manifest import observation_layout
from export.network import Layer, Network, n_parameters
from export.population import Population
from export.prior import Prior
from task.errors import UserError
from task.state import N_OBSERVATION

SMALL = Network(layers=(Layer(units=8), Layer(units=3)))


def test_every_file_is_hashed_and_every_member_has_golden_samples(population_folder):
    manifest = json.loads((population_folder / "manifest.json").read_bytes())
    files = {p.relative_to(population_folder).as_posix() for p in population_folder.rglob("*") if p.is_file()}
    assert set(manifest["files"]) == files - {"manifest.json"}
    assert len(manifest["golden_actions"]["actions"]) == len(manifest["members"]) == 4
    assert len(manifest["golden_imagination"]["returns"]) == 5
    assert len(manifest["golden_laws"]["returns"]) == len(manifest["golden_laws"]["maps"]) == 3
    assert manifest["champion"] == "actor-1"
    assert manifest["training"] == {"seed": 0}


def test_the_graphs_pass_the_checker_and_carry_their_names(population_folder):
    for name in ("behaviour", "imagination", "laws"):
        model = onnx.load(population_folder / f"{name}.onnx")
        onnx.checker.check_model(model, full_check=True)
        assert model.graph.name == name


def test_observation_layout_gives_errors_and_states_their_units():
    layout = observation_layout()
    assert len(layout) == N_OBSERVATION
    assert [s.symbol for s in layout] == ["theta_e", "phi_e", "beta_e", "p", "q", "r", "alpha"]
    assert [s.unit for s in layout] == ["rad", "rad", "rad", "rad/s", "rad/s", "rad/s", "rad"]


def test_two_exports_are_equal_bit_for_bit(tmp_path, make_actors, short_prior):
    for parent in ("a", "b"):
        write_population(make_actors(SMALL), short_prior, tmp_path / parent / "cast")
    names = sorted(p.name for p in (tmp_path / "a" / "cast").iterdir())
    assert names == sorted(p.name for p in (tmp_path / "b" / "cast").iterdir())
    for name in names:
        assert (tmp_path / "a" / "cast" / name).read_bytes() == (tmp_path / "b" / "cast" / name).read_bytes(), name


def test_a_failing_export_leaves_the_old_population(tmp_path, make_actors, short_prior):
    target = tmp_path / "cast"
    write_population(make_actors(SMALL, seed=1), short_prior, target)
    before = {p.name: p.read_bytes() for p in target.iterdir()}
    missing = {"config.toml": tmp_path / "not-there.toml"}
    with pytest.raises(FileNotFoundError):
        write_population(make_actors(SMALL, seed=2), short_prior, target, missing)
    assert {p.name: p.read_bytes() for p in target.iterdir()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["cast"]


def test_an_older_population_is_replaced_and_anything_else_is_not(tmp_path, make_actors, short_prior):
    target = tmp_path / "cast"
    write_population(make_actors(SMALL, members=2), short_prior, target)
    write_population(make_actors(SMALL, members=3), short_prior, target)
    assert np.load(target / "parameters.npy").shape[0] == 3
    assert [p.name for p in tmp_path.iterdir()] == ["cast"]
    (tmp_path / "diary").mkdir()
    (tmp_path / "diary" / "monday.txt").write_text("mine")
    with pytest.raises(UserError, match="diary: exists and is not a population"):
        write_population(make_actors(SMALL), short_prior, tmp_path / "diary")
    assert (tmp_path / "diary" / "monday.txt").read_text() == "mine"


@pytest.mark.parametrize("graph", ["behaviour", "imagination", "laws"])
def test_a_graph_that_differs_from_its_reference_is_never_shipped(
    graph, tmp_path, make_actors, short_prior, monkeypatch
):
    """Weights other than the population's, or laws that read the altitude: the golden samples find it."""
    if graph == "behaviour":
        wrong = folder_module.behaviour(Network(layers=SMALL.layers, action_scale=(0.1, 0.1, 0.1)))
        monkeypatch.setattr(folder_module, "behaviour", lambda network: wrong)
    elif graph == "laws":
        wrong = folder_module.law_imagination(1)
        (mask,) = (i for i in wrong.graph.initializer if i.name == "read")
        mask.CopyFrom(onnx.numpy_helper.from_array(np.ones(mask.dims, dtype=np.float32), mask.name))
        monkeypatch.setattr(folder_module, "law_imagination", lambda lag: wrong)
    else:
        wrong = folder_module.imagination(SMALL, 2.0 * make_actors(SMALL).parameters, 1)
        monkeypatch.setattr(folder_module, "imagination", lambda *arguments: wrong)
    with pytest.raises(RuntimeError, match=f"{graph}.onnx differs from its reference"):
        write_population(make_actors(SMALL), short_prior, tmp_path / "cast")
    assert not any(tmp_path.iterdir())


def test_the_prior_is_stored_at_full_precision(population_folder, short_prior: Prior):
    with np.load(population_folder / "model_prior.npz") as stored:
        np.testing.assert_array_equal(stored["theta"], short_prior.theta)
        np.testing.assert_array_equal(stored["p0"], short_prior.p0)


def test_members_of_high_gain_are_asked_smaller_observations_in_which_every_parameter_is_seen(make_actors):
    gentle = make_actors(SMALL)
    usual = golden_actions(gentle)
    assert len(usual.observations) == GOLDEN_OBSERVATIONS
    linear = Network(layers=(Layer(units=3),))
    gains = np.ones((2, n_parameters(linear)), dtype=np.float32)
    gains[:, -3:] = 0.0  # biases
    gains[1] *= 100.0
    description = msgspec.structs.replace(
        gentle.description, network=linear, members=gentle.description.members[:2],
        champion=gentle.description.members[0].name,
    )  # fmt: skip
    golden = golden_actions(Population(description, gains))
    assert golden.observations[:GOLDEN_OBSERVATIONS] == usual.observations
    assert len(golden.observations) > GOLDEN_OBSERVATIONS
    for k in range(gains.shape[1]):
        other = gains.copy()
        other[1, k] += 1.0
        changed = np.abs(np.array(golden_actions(Population(description, other)).actions)[1] - golden.actions[1])
        assert changed.max() > golden.tolerance


def test_parameters_beyond_single_precision_are_the_member_s_fault(tmp_path, make_actors, short_prior):
    population = make_actors(Network(layers=(Layer(units=8, layer_norm="standard"), Layer(units=3))))
    parameters = population.parameters.copy()
    parameters[2] *= 1e30
    with pytest.raises(UserError, match=r"member 'actor-2': in single precision .* its largest parameter is \d.*e\+30"):
        write_population(population._replace(parameters=parameters), short_prior, tmp_path / "cast")
    assert not any(tmp_path.iterdir())


def test_a_population_is_put_back_when_the_new_one_cannot_take_its_place(
    tmp_path, make_actors, short_prior, monkeypatch
):
    target = tmp_path / "cast"
    write_population(make_actors(SMALL, seed=1), short_prior, target)
    before = {p.name: p.read_bytes() for p in target.iterdir()}
    rename = Path.rename

    def refusing(path, other):
        if path.name == "new":
            raise OSError(16, "Device or resource busy")
        return rename(path, other)

    monkeypatch.setattr(Path, "rename", refusing)
    with pytest.raises(UserError, match=r"cast: cannot be written: Device or resource busy"):
        write_population(make_actors(SMALL, seed=2), short_prior, target)
    assert {p.name: p.read_bytes() for p in target.iterdir()} == before


@pytest.mark.parametrize("folder", [".", "..", "../.."])
def test_a_population_needs_a_name(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="expected a folder named as the population"):
        check_place(Path(folder))
