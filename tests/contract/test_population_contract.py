"""The population folder between two programs that share no code: what one writes, the other reads and flies alike."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

import export.folder
import export.manifest
import runtime.manifest
import runtime.population
from export.card import card
from export.golden import golden_actions
from export.network import Layer, Network, forward, unflatten
from export.population import Description, Population
from export.rollout import rollout
from runtime.imagination import Imagination, Snapshot
from runtime.population import BehaviouralPolicy, load_population
from task.config import load_json
from task.errors import UserError
from task.model import embed_reduced
from task.reference import random_reference

SHIPPED = sorted(p.parent for p in Path(__file__).parents[2].glob("populations/*/manifest.json"))

NETWORKS = {
    "thesis": Network(layers=(Layer(units=24), *[Layer(units=24, layer_norm="unbiased")] * 3, Layer(units=3))),
    "relu": Network(layers=(*[Layer(units=20, activation="relu")] * 2, Layer(units=3))),
    "scaled": Network(
        layers=(Layer(units=12, layer_norm="standard", activation="leaky_relu"), Layer(units=3)),
        input_scale=(2.0, 2.0, 4.0, 1.0, 1.0, 1.0, 0.5),
        action_offset=(-0.02, 0.0, 0.01),
    ),
    "linear-law": Network(layers=(Layer(units=3, activation="linear"),)),
}


@pytest.fixture(params=NETWORKS)
def cast(request, tmp_path, make_actors, short_prior):
    """A population as it was exported, and as it was loaded."""
    population = make_actors(NETWORKS[request.param], members=3, seed=2)
    export.folder.write_population(population, short_prior, tmp_path / "cast")
    return population, load_population(tmp_path / "cast")


def test_both_sides_name_the_same_keys():
    def keys(kind: type) -> dict:
        return {
            f.encode_name: msgspec.inspect.type_info(f.type).__class__.__name__ for f in msgspec.structs.fields(kind)
        }

    for name in ("Manifest", "Layer", "Network", "Tensor", "Member", "SignalLayout", "PriorLayout"):
        written = getattr(export.manifest, name, None) or getattr(export.network, name)
        assert keys(written) == keys(getattr(runtime.manifest, name)), name
    for name in ("GoldenActions", "GoldenImagination", "GoldenLaws"):
        assert keys(getattr(export.manifest, name)) == keys(getattr(runtime.manifest, name)), name


def test_both_sides_name_the_same_files_and_version():
    for name in ("BEHAVIOUR", "IMAGINATION", "LAWS", "PRIOR"):
        assert getattr(export.folder, name) == getattr(runtime.population, name)
    assert export.population.PARAMETERS == runtime.population.PARAMETERS
    assert export.manifest.MANIFEST == runtime.population.MANIFEST
    assert (export.manifest.FORMAT, export.manifest.VERSION) == (runtime.manifest.FORMAT, runtime.manifest.VERSION)


def test_the_runtime_flies_what_was_exported(cast):
    exported, loaded = cast
    policy = BehaviouralPolicy(loaded)
    tensors = unflatten(exported.network, exported.parameters.astype(float))
    for s in np.random.default_rng(0).uniform(-0.4, 0.4, (20, 7)).astype(np.float32):
        expected = forward(exported.network, tensors, s.astype(float))
        for member in range(3):
            policy.parameters[:] = loaded.parameters[member]
            np.testing.assert_allclose(policy.act(s), expected[member], rtol=0, atol=2e-6)


def test_the_runtime_imagines_what_was_exported_and_any_incumbent(cast):
    exported, loaded = cast
    rng = np.random.default_rng(1)
    blend = (0.5 * (exported.parameters[0] + exported.parameters[2])).astype(np.float32)
    x = np.array([0.01, 0.0, 0.0, 90.0, 0.06, 0.0, 0.05, 0.06, 1.0, 2000.0])
    reference = random_reference(rng, 2.0, 0.06)
    commands, dx, delay = rng.uniform(-0.03, 0.0, (22, 3)), 1e-4 * rng.normal(size=10), 4
    model = embed_reduced(loaded.theta)
    with Imagination(loaded, 200) as imagination:
        imagination.request(Snapshot(x, dx, commands, delay, model, True, reference, blend), 0)
        (returns,) = imagination.wait(0).returns
    actors = np.concatenate([exported.parameters, blend[None]])
    expected = rollout(exported.network, actors, x, dx, commands, delay, model, True, reference).returns
    np.testing.assert_allclose(returns, expected, rtol=0, atol=1e-3)


def test_the_manifest_is_at_full_precision(cast):
    exported, loaded = cast
    golden = loaded.manifest.golden_actions
    tensors = unflatten(exported.network, exported.parameters.astype(float))
    again = np.stack([forward(exported.network, tensors, np.array(s)) for s in golden.observations], axis=1)
    np.testing.assert_array_equal(np.array(golden.actions), again)


def test_no_pickle_anywhere(population_folder):
    for path in population_folder.rglob("*"):
        if path.suffix in (".npy", ".npz"):
            np.load(path, allow_pickle=False)
        assert path.suffix not in (".pkl", ".pickle", ".pt", ".pth")


def test_a_key_that_one_side_forgets_is_found(population_folder, tmp_path):
    data = json.loads((population_folder / "manifest.json").read_bytes())
    del data["command_lag"]
    (tmp_path / "manifest.json").write_text(json.dumps(data))
    with pytest.raises(UserError, match="missing required field `command_lag`"):
        load_population(tmp_path)


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda p: p.name)
def test_shipped_populations_load_and_are_whole(folder):
    population = load_population(folder)
    assert population.name == folder.name
    files = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert set(population.manifest.files) == files - {"manifest.json"}
    assert export.manifest.file_hashes(folder) == population.manifest.files


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda p: p.name)
def test_shipped_golden_samples_see_the_parameters_of_every_member(folder):
    """They are those that an export makes today, the smaller ones included."""
    manifest = load_json(folder / "manifest.json", export.manifest.Manifest)
    description = Description(network=manifest.network, members=manifest.members, champion=manifest.champion)
    made = golden_actions(Population(description, np.load(folder / "parameters.npy")))
    shipped = manifest.golden_actions
    assert shipped.observations == made.observations
    np.testing.assert_allclose(shipped.actions, made.actions, atol=1e-12)
    away = np.abs(np.array(shipped.actions) - manifest.network.action_offset)
    assert (away < 0.9 * np.abs(manifest.network.action_scale)).any(axis=1).all()


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda p: p.name)
def test_shipped_cards_say_what_an_export_says_today(folder):
    """All but the screening, whose flights are not kept; of it the members' figures, which the manifest has too."""
    manifest = load_json(folder / "manifest.json", export.manifest.Manifest)
    description = Description(
        network=manifest.network, members=manifest.members, champion=manifest.champion, training=manifest.training
    )
    population = Population(description, np.load(folder / "parameters.npy"))
    written = card(population, manifest.name, manifest.exported_with, None)
    shipped = (folder / "MODEL_CARD.md").read_text()
    assert shipped.partition("## Screening")[0] == written.partition("## Screening")[0]
    rows = {cells[0]: cells[1:] for line in shipped.splitlines() if len(cells := line.strip("| ").split(" | ")) == 6}
    for member in manifest.members:
        passed, error, _, lost, verdict = rows[member.name]
        assert int(passed) == member.scores["screening_cases_passed"]
        assert float(error) == pytest.approx(member.scores["screening_nominal_nmae"], abs=0.006)
        assert int(lost) == member.scores["screening_lost"]
        assert verdict == manifest.training["screening"]["verdicts"][member.name]
