"""Loading a cast: a sound one flies, a damaged or foreign one gets its one line."""

from __future__ import annotations

import hashlib
import json
import shutil
import tracemalloc

import numpy as np
import onnx
import pytest

from runtime.population import BehaviouralPolicy, load_population
from task.errors import UserError


@pytest.fixture
def folder(population_folder, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(population_folder, tmp_path / "cast")


def edit(folder, path, value):
    """Set one key of the manifest, e.g. ``observation.0.unit``."""
    file = folder / "manifest.json"
    data = at = json.loads(file.read_bytes())
    *steps, last = path.split(".")
    for step in steps:
        at = at[int(step) if step.isdigit() else step]
    at[int(last) if last.isdigit() else last] = value
    file.write_text(json.dumps(data))


def rehash(folder, name):
    """Make the manifest agree with a file that was changed, as a forger or a careless tool would."""
    digest = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    file = folder / "manifest.json"
    data = json.loads(file.read_bytes())
    data["files"][name] = digest
    file.write_text(json.dumps(data))


def damage(folder, name):
    """Flip one bit in the middle of a file."""
    content = bytearray((folder / name).read_bytes())
    content[len(content) // 2] ^= 1
    (folder / name).write_bytes(content)


def forge(folder, name, content):
    (folder / name).write_bytes(content)
    rehash(folder, name)


def other_weights(folder):
    model = onnx.load(folder / "imagination.onnx")
    for tensor in model.graph.initializer:
        if tensor.name == "layers.0.weight":
            array = 1.1 * onnx.numpy_helper.to_array(tensor)
            tensor.CopyFrom(onnx.numpy_helper.from_array(array, tensor.name))
    forge(folder, "imagination.onnx", model.SerializeToString())


def other_scale(folder):
    model = onnx.load(folder / "behaviour.onnx")
    for tensor in model.graph.initializer:
        if tensor.name == "action_scale":
            array = 2 * onnx.numpy_helper.to_array(tensor)
            tensor.CopyFrom(onnx.numpy_helper.from_array(array, tensor.name))
    forge(folder, "behaviour.onnx", model.SerializeToString())


def swapped_graphs(folder):
    forge(folder, "behaviour.onnx", (folder / "imagination.onnx").read_bytes())


def odd_parameters(folder):
    np.save(folder / "parameters.npy", np.load(folder / "parameters.npy")[:, :-1])
    rehash(folder, "parameters.npy")


def prior(folder, **changes):
    arrays = {"theta": np.zeros((11, 6)), "p0": np.eye(11), "learnt_at": [90.0, 2000.0]} | changes
    np.savez(folder / "model_prior.npz", **{name: each for name, each in arrays.items() if each is not None})
    rehash(folder, "model_prior.npz")


SPOILS = {
    "no manifest": (lambda f: (f / "manifest.json").unlink(), "manifest.json: no such manifest of a population"),
    "manifest cut": (
        lambda f: (f / "manifest.json").write_bytes((f / "manifest.json").read_bytes()[:500]),
        "manifest.json: not valid JSON",
    ),
    "not a population": (lambda f: (f / "manifest.json").write_text("{}"), "missing required field `format`"),
    "foreign format": (lambda f: edit(f, "format", "zoo"), "format: expected 'understudy-population', got 'zoo'"),
    "newer version": (lambda f: edit(f, "version", 4), "this runtime reads 3, got 4"),
    "older version": (lambda f: edit(f, "version", 2), "this runtime reads 3, got 2; export it again"),
    "unknown key": (lambda f: edit(f, "colour", "red"), "unknown field `colour`"),
    "missing graph": (lambda f: (f / "behaviour.onnx").unlink(), "behaviour.onnx: no such file of the population"),
    "missing parameters": (lambda f: (f / "parameters.npy").unlink(), "parameters.npy: no such file"),
    "damaged behaviour": (lambda f: damage(f, "behaviour.onnx"), "behaviour.onnx: SHA-256 .* the file was changed"),
    "damaged imagination": (lambda f: damage(f, "imagination.onnx"), "imagination.onnx: SHA-256"),
    "damaged parameters": (lambda f: damage(f, "parameters.npy"), "parameters.npy: SHA-256"),
    "damaged prior": (lambda f: damage(f, "model_prior.npz"), "model_prior.npz: SHA-256"),
    "no hash": (lambda f: edit(f, "files", {}), "is not the manifest's no hash"),
    "graph is no graph": (lambda f: forge(f, "imagination.onnx", b"\x08\x01nonsense"), "imagination.onnx: onnxruntime"),
    "swapped graphs": (swapped_graphs, "behaviour.onnx: inputs or output differ from the manifest"),
    "other weights": (other_weights, "imagination.onnx: the golden imagination is .* off"),
    "other scale": (other_scale, "behaviour.onnx: member 'actor-0' answers a golden sample .* rad off"),
    "golden sample": (
        lambda f: edit(f, "golden_actions.actions.2.1.0", 0.5),
        "member 'actor-2' answers a golden sample",
    ),
    "golden shape": (lambda f: edit(f, "golden_actions.actions", [[[0, 0, 0]]]), "golden_actions.actions: expected"),
    "golden observations": (
        lambda f: edit(f, "golden_actions.observations.1", [0.0]),
        "golden_actions.observations: expected rows of equal length",
    ),
    "golden commands": (
        lambda f: edit(f, "golden_imagination.commands.1", [0.0]),
        "golden_imagination.commands: expected rows of equal length",
    ),
    "golden incumbent": (
        lambda f: edit(f, "golden_imagination.incumbent", 999),
        "golden_imagination.incumbent: expected a member's number below 4, got 999",
    ),
    "two of one name": (lambda f: edit(f, "members.1.name", "actor-0"), "members: expected each a name .* 'actor-0'"),
    "no name": (lambda f: edit(f, "members.1.name", ""), "members: expected each a name of its own, got ''"),
    "golden reference": (lambda f: edit(f, "golden_imagination.reference", [[0.0]]), "cannot play the golden"),
    "observation order": (lambda f: edit(f, "observation.0.symbol", "phi_e"), "observation: expected"),
    "observation unit": (lambda f: edit(f, "observation.3.unit", "deg/s"), "observation: expected .*deg/s"),
    "action unit": (lambda f: edit(f, "action.0.unit", "deg"), "action: expected"),
    "state order": (lambda f: edit(f, "state.3.symbol", "u"), "state: expected"),
    "network inputs": (lambda f: edit(f, "network.observation", 9), "network.observation: expected 7, got 9"),
    "sample time": (lambda f: edit(f, "dt", 0.02), "dt: expected 0.01, got 0.02"),
    "command lag": (lambda f: edit(f, "command_lag", -1), "command_lag: expected 0 or more"),
    "other command lag": (lambda f: edit(f, "command_lag", 2), "imagination.onnx: inputs or output differ"),
    "delay": (lambda f: edit(f, "max_delay", -1), "max_delay: expected 0 or more"),
    "other delay": (lambda f: edit(f, "max_delay", 2), "imagination.onnx: inputs or output differ"),
    "champion": (lambda f: edit(f, "champion", "nobody"), "champion: expected one of the 4 members"),
    "parameter offset": (lambda f: edit(f, "parameters.1.offset", 0), "layers.0.bias: offset: expected 112, got 0"),
    "parameters shape": (odd_parameters, r"parameters.npy: expected finite float32 \(4, "),
    "parameters pickled": (
        lambda f: forge(f, "parameters.npy", b"\x80\x04}."),
        "parameters.npy: not a plain .npy array",
    ),
    "prior shape": (
        lambda f: prior(f, theta=np.zeros((13, 10)), p0=np.eye(13)),
        r"model_prior.npz: expected finite theta \(11, 6\)",
    ),
    "prior of nowhere": (
        lambda f: prior(f, learnt_at=None),
        "model_prior.npz: expected arrays .* export the population",
    ),
    "prior at rest": (
        lambda f: prior(f, learnt_at=[0.0, 2000.0]),
        r"learnt_at: expected speed > 0 .* got \(0.0, 2000.0",
    ),
    "prior is no zip": (lambda f: forge(f, "model_prior.npz", b"zip"), "model_prior.npz: expected arrays theta"),
    "prior layout": (lambda f: edit(f, "model_prior.outputs.0", "q"), "model_prior.outputs: expected"),
}


@pytest.mark.parametrize("case", SPOILS)
def test_each_fault_has_its_one_line(case, folder, capfd):
    spoil, message = SPOILS[case]
    spoil(folder)
    with pytest.raises(UserError, match=message) as caught:
        load_population(folder)
    assert "\n" not in str(caught.value)
    assert "cast" in str(caught.value)
    assert capfd.readouterr() == ("", "")  # nor does onnxruntime print past it


def test_a_missing_population_is_named(tmp_path):
    with pytest.raises(UserError, match="nowhere: no such population"):
        load_population(tmp_path / "nowhere")


def test_training_records_are_not_needed_to_fly(folder):
    edit(folder, "files.training", "0" * 64)
    assert load_population(folder).name == "random"


def test_a_sound_population_is_what_its_manifest_says(population_folder):
    population = load_population(population_folder)
    assert (population.name, population.champion, population.command_lag) == ("random", 1, 1)
    assert population.members == [f"actor-{i}" for i in range(4)]
    assert population.parameters.shape == (4, population.manifest.n_parameters)
    assert population.theta.shape == (11, 6)
    assert population.p0.shape == (11, 11)
    with pytest.raises(ValueError, match="read-only"):
        population.parameters[0, 0] = 1.0


class TestBehaviouralPolicy:
    @pytest.fixture
    def population(self, population_folder):
        return load_population(population_folder)

    @pytest.fixture
    def policy(self, population):
        return BehaviouralPolicy(population)

    def test_it_starts_as_the_champion(self, policy, population):
        np.testing.assert_array_equal(policy.parameters, population.parameters[1])
        golden = population.manifest.golden_actions
        for s, action in zip(golden.observations, golden.actions[1], strict=True):
            np.testing.assert_allclose(policy.act(np.array(s)), action, rtol=0, atol=golden.tolerance)

    def test_a_change_of_its_parameters_flies_at_once(self, policy, population):
        s = np.full(7, 0.1)
        before = policy.act(s).copy()
        policy.parameters[:] = population.parameters[3]
        after = policy.act(s).copy()
        assert np.abs(after - before).max() > 1e-3
        other = BehaviouralPolicy(population)
        other.parameters[:] = population.parameters[3]
        np.testing.assert_array_equal(other.act(s), after)

    def test_it_never_writes_into_the_population(self, policy, population):
        before = population.parameters.copy()
        policy.parameters[:] = 0.0
        np.testing.assert_array_equal(policy.act(np.ones(7)), 0.0)
        np.testing.assert_array_equal(population.parameters, before)

    def test_nan_comes_out_where_nan_went_in(self, policy):
        """The gate behind the policy sees it; the policy itself does not raise."""
        assert np.isnan(policy.act(np.full(7, np.nan))).all()
        assert np.isfinite(policy.act(np.zeros(7))).all()

    def test_a_call_leaves_nothing_behind(self, policy, without_collections):
        s, grown = np.zeros(7), []
        tracemalloc.start()
        try:
            for _ in range(300):  # the interpreter's own lists of freed objects fill once
                policy.act(s)
            for _ in range(3):  # what calls leave grows each time, unlike what a thread of another test ends with
                before = tracemalloc.take_snapshot()
                for _ in range(1000):
                    policy.act(s)
                differences = tracemalloc.take_snapshot().compare_to(before, "filename")
                grown.append(sum(d.size_diff for d in differences if "runtime" in str(d)))
        finally:
            tracemalloc.stop()
        assert min(grown) < 512
        assert policy.act(s) is policy.act(s)
