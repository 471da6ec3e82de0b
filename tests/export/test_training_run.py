"""A run as a whole: what it learns, leaves behind, survives and refuses."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import torch
from click.testing import CliRunner

from export.network import n_parameters
from export.population import load_run
from export.training import checkpoint
from export.training.cli import train as command
from export.training.config import CONFIGS, TrainingConfig, as_toml, load
from export.training.curve import Row, draw, write_csv
from export.training.rollouts import discounted_penalty
from export.training.run import start
from export.training.train import CHECKPOINT, Trainer
from export.training.worker import FlightWorker
from task.errors import UserError

TINY = """
name = "tiny"
frames = 3000
seed = 3
validation_references = 1
checkpoint_seconds = 0.0

[actor]
width = 8
hidden = 1
input_scale = [8.0, 8.0, 20.0, 4.0, 4.0, 4.0, 8.0]

[td3]
batch = 16
critic_layers = [8, 8]
buffer = 2000
learning_starts = 200
updates_per_frame = 0.2

[genetic]
population = 4
evaluations = 2
elite_fraction = 0.25
mutation_batch = 16
memory = 200
pairing_batch = 32
crossover_epochs = 2
crossover_batch = 32

[task]
duration = 1.0
"""
CPU = torch.device("cpu")


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


def invoke(*arguments: object) -> str:
    """Run the command; a UserError is raised as it is."""
    result = CliRunner().invoke(command, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_a_run_leaves_a_population_that_export_reads(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    output = invoke(tiny, "--out", folder)
    population = load_run(folder)
    assert population.parameters.shape == (5, n_parameters(population.network))
    names = [member.name for member in population.description.members]
    assert names == ["actor_0", "actor_1", "actor_2", "actor_3", "td3"]
    best = min(
        population.description.members, key=lambda m: (m.scores["validation_lost"] > 0, m.scores["validation_nmae"])
    )
    assert population.description.champion == best.name
    training = population.description.training
    assert training["seed"] == 3
    assert training["frames"] >= 3000
    assert training["config"]["genetic"]["population"] == 4
    assert load(str(folder / "config.toml")) == load(str(tiny))
    with (folder / "learning_curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["generation"]) for row in rows] == list(range(1, len(rows) + 1))
    assert int(rows[-1]["frames"]) == training["frames"]
    assert (folder / "learning_curve.png").read_bytes().startswith(b"\x89PNG")
    assert "100.0 %" in output
    assert not list(folder.glob(".*partial"))


def members(folder: Path) -> np.ndarray:
    return load_run(folder).parameters


def test_killed_and_resumed_equals_uninterrupted(tiny: Path, tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    invoke(tiny, "--out", whole)
    code = "from export.training.cli import train; train()"
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    arguments = [sys.executable, "-c", code, str(tiny), "--out", str(broken)]
    for generations in (2, 4):
        process = subprocess.Popen(arguments, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline and process.poll() is None:
            curve = broken / "learning_curve.csv"
            if curve.exists() and len(curve.read_text().splitlines()) > generations:
                break
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert not (broken / "parameters.npy").exists(), "the run ended before it could be killed"
    output = invoke(tiny, "--out", broken)
    assert "resumed at generation" in output
    np.testing.assert_array_equal(members(broken), members(whole))


def test_interrupted_run_keeps_its_checkpoint_and_says_how_to_go_on(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    code = "from export.training.cli import train; from understudy import run; run(train)"
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tiny), "--out", str(folder), "--frames", "1000000"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while not (folder / "learning_curve.csv").exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "understudy: stopped at frame" in errors
    assert "the same command goes on" in errors
    assert "Traceback" not in errors
    _, meta = checkpoint.load(folder / CHECKPOINT)
    with (folder / "learning_curve.csv").open() as file:
        assert len(meta["curve"]) == sum(1 for _ in file) - 1


def test_more_frames_continue_a_finished_run(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    invoke(tiny, "--out", folder)
    before = load_run(folder).description.training["frames"]
    invoke(tiny, "--out", folder, "--frames", before + 1)
    assert load_run(folder).description.training["frames"] > before


def test_another_configuration_does_not_resume(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    invoke(tiny, "--out", folder)
    other = tmp_path / "other.toml"
    other.write_text(TINY.replace("batch = 16\ncritic", "batch = 32\ncritic"))
    with pytest.raises(UserError, match=r"td3\.batch = 16, but the configuration says 32.*--fresh"):
        invoke(other, "--out", folder)
    invoke(other, "--out", folder, "--fresh")


def test_a_damaged_checkpoint_is_one_line(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    for content in (b"", b"PK\x03\x04 not really", b"\x93NUMPY"):
        (folder / CHECKPOINT).write_bytes(content)
        with pytest.raises(UserError, match=r"checkpoint\.npz: not a checkpoint"):
            invoke(tiny, "--out", folder)


def rewritten(path: Path, spoil: Callable[[dict[str, np.ndarray], dict[str, Any]], object]) -> None:
    """Save a checkpoint again with ``spoil`` done to its arrays and to what it says of itself."""
    tensors, meta = checkpoint.load(path)
    spoil(tensors, meta)
    checkpoint.save(path, tensors, meta)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda tensors, meta: tensors.pop("generator"), "KeyError 'generator'"),
        (lambda tensors, meta: tensors.pop("learner.updates"), "KeyError 'updates'"),
        (lambda tensors, meta: tensors.update({"population.parameters": torch.zeros(2, 3)}), "size of tensor"),
        (lambda tensors, meta: tensors.update(generator=torch.zeros(16, dtype=torch.uint8)), "--device cpu"),
        (lambda tensors, meta: meta.pop("rng"), "KeyError 'rng'"),
        (lambda tensors, meta: meta["curve"][0].pop("q"), "missing required field `q`"),
        (lambda tensors, meta: meta.pop("config"), "not a checkpoint of a training run: KeyError 'config'"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_one_line(
    spoil: Callable[[dict[str, np.ndarray], dict[str, Any]], object], message: str, tiny: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    invoke(tiny, "--out", folder, "--frames", 500)
    rewritten(folder / CHECKPOINT, spoil)
    before = (folder / CHECKPOINT).read_bytes()
    with pytest.raises(UserError, match=rf"checkpoint\.npz: .*{message}.*--fresh") as refused:
        invoke(tiny, "--out", folder)
    assert "\n" not in str(refused.value)
    assert (folder / CHECKPOINT).read_bytes() == before


def test_a_population_without_a_checkpoint_is_not_overwritten_unasked(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    invoke(tiny, "--out", folder, "--frames", 500)
    (folder / CHECKPOINT).unlink()
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(UserError, match=r"holds a population, but no checkpoint\.npz .*--fresh"):
        invoke(tiny, "--out", folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    invoke(tiny, "--out", folder, "--frames", 500, "--fresh")


def test_while_a_run_is_overwritten_the_old_population_is_not_taken_for_its_own(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    invoke(tiny, "--out", folder, "--frames", 500)
    config = load(str(tiny))
    start(msgspec.structs.replace(config, seed=4), folder, CPU, resume=False)
    with pytest.raises(UserError, match=r"population\.json: no such description"):
        load_run(folder)


def test_a_learner_that_diverges_is_one_line_and_costs_no_checkpoint(tmp_path: Path) -> None:
    path = tmp_path / "wild.toml"
    text = TINY.replace("[td3]", "[td3]\nreward_scale = 1e29").replace(
        "learning_starts = 200", "learning_starts = 1500"
    )
    path.write_text(text)
    folder = tmp_path / "run"
    with pytest.raises(UserError, match=r"generation \d+: the TD3 learner diverged.*lower td3\.learning_rate"):
        invoke(path, "--out", folder)
    assert Trainer.resume(folder / CHECKPOINT, load(str(path)), CPU).frames > 0


@pytest.mark.parametrize("option", ["--seed", "--frames"])
def test_numbers_that_a_configuration_could_not_hold_are_refused(option: str, tiny: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [str(tiny), "--out", str(tmp_path / "run"), option, str(2**31)])
    assert result.exit_code == 2
    assert f"'{option}'" in result.output


def test_a_folder_that_takes_no_files_is_one_line(tiny: Path) -> None:
    with pytest.raises(UserError, match=r"--out: /proc/self/fdinfo: cannot be written"):
        invoke(tiny, "--out", "/proc/self/fdinfo")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("batch = 16", r"learning_rat"),
        ("gamma", r"\$\.td3\.gamma|gamma"),
        ("stored", r"stored_evaluations: expected at most"),
        ("scale", r"input_scale: expected 7"),
        ("seed", r"expected `int` >= 0, got -1 - at `\$\.seed`"),
        ("short", r"expected `float` >= 0\.1 \[s\], got 0\.001 - at `\$\.task\.duration`"),
        ("endless", r"expected `float` <= 3600\.0 \[s\], got inf - at `\$\.task\.duration`"),
        ("buffer", r"got 100000000000.* - at `\$\.td3\.buffer`"),
        ("rate", r"expected a finite number, got inf - at `\$\.td3\.learning_rate`"),
        ("offset", r"expected a finite number, got nan - at `\$\.actor\.action_offset\[1\]`"),
        ("nameless", r"got '' - at `\$\.name`"),
        ("escaping", r"got '\.\./tiny' - at `\$\.name`"),
        ("never", r"td3\.buffer: expected more than td3\.learning_starts = 2000, .*got 2000"),
        ("forgetful", r"genetic\.memory: expected more than genetic\.mutation_batch = 16, .*got 16"),
        ("narrow", r"actor\.width: expected at least 2 units"),
        ("constant", r"td3\.critic_layers: expected at least 2 units"),
    ],
)
def test_bad_configurations_name_the_key(change: str, message: str, tmp_path: Path) -> None:
    edits = {
        "batch = 16": TINY.replace("[td3]", "[td3]\nlearning_rat = 1e-4"),
        "gamma": TINY.replace("[td3]", "[td3]\ngamma = 1.5"),
        "stored": TINY.replace("[genetic]", "[genetic]\nstored_evaluations = 7"),
        "seed": TINY.replace("seed = 3", "seed = -1"),
        "short": TINY.replace("duration = 1.0", "duration = 0.001"),
        "endless": TINY.replace("duration = 1.0", "duration = inf"),
        "buffer": TINY.replace("buffer = 2000", "buffer = 100_000_000_000"),
        "rate": TINY.replace("[td3]", "[td3]\nlearning_rate = inf"),
        "offset": TINY.replace("[actor]", "[actor]\naction_offset = [0.0, nan, 0.0]"),
        "nameless": TINY.replace('"tiny"', '""'),
        "escaping": TINY.replace('"tiny"', '"../tiny"'),
        "never": TINY.replace("learning_starts = 200", "learning_starts = 2000"),
        "forgetful": TINY.replace("memory = 200", "memory = 16"),
        "narrow": TINY.replace("width = 8", "width = 1"),
        "constant": TINY.replace("critic_layers = [8, 8]", "critic_layers = [8, 1]"),
        "scale": TINY.replace("input_scale = [8.0, ", "input_scale = ["),
    }
    path = tmp_path / "bad.toml"
    path.write_text(edits[change])
    with pytest.raises(UserError, match=message):
        Trainer(load(str(path)), CPU)


def test_unknown_configuration_and_device_are_one_line(tiny: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no training configuration 'serl11'.*serl10"):
        load("serl11")
    for device in ("nonsense", "meta"):
        with pytest.raises(UserError, match=rf"--device {device}: no such device here; expected cpu"):
            invoke(tiny, "--out", tmp_path / "run", "--device", device)


@pytest.mark.parametrize("name", sorted(path.stem for path in CONFIGS.glob("*.toml")))
def test_shipped_configurations_load_and_survive_writing(name: str, tmp_path: Path) -> None:
    config = load(name)
    assert config.name == name
    path = tmp_path / "again.toml"
    path.write_text(as_toml(config))
    assert load(str(path)) == config


def trainer(**genetic: object) -> Trainer:
    config = msgspec.convert(tomllib.loads(TINY), TrainingConfig)
    settings = msgspec.structs.replace(config.genetic, **genetic)
    return Trainer(msgspec.structs.replace(config, genetic=settings), CPU)


def overlapping() -> TrainingConfig:
    config = msgspec.convert(tomllib.loads(TINY), TrainingConfig)
    return msgspec.structs.replace(
        config,
        overlap=True,
        td3=msgspec.structs.replace(config.td3, exploring_flights=2),
        genetic=msgspec.structs.replace(config.genetic, stored_share=0.5, mutation_end=0.2),
    )


def test_flights_in_a_worker_change_nothing(tmp_path: Path) -> None:
    ends = []
    for workers in (0, 1):
        t = Trainer(overlapping(), CPU, workers=workers)
        for _ in range(4):
            t.generation()
        ends.append((t.members(), t.replay.rows.clone()))
        t.close()
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    torch.testing.assert_close(ends[0][1], ends[1][1], rtol=0, atol=0)


@pytest.mark.parametrize("asked", ["start", "result"])
def test_a_worker_that_was_killed_is_one_line(asked: str) -> None:
    worker = FlightWorker(overlapping().task, discount_penalty=True)
    worker._process.kill()
    worker._process.join()
    with pytest.raises(UserError, match="the process that flies ended before its flights; the same command goes on"):
        worker.start([]) if asked == "start" else worker.result()
    worker.close()


def test_a_run_killed_while_its_worker_flies_goes_on(tmp_path: Path) -> None:
    config = tmp_path / "overlapping.toml"
    config.write_text(as_toml(overlapping()))
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    invoke(config, "--out", whole, "--workers", 0)
    code = "from export.training.cli import train; train()"
    process = subprocess.Popen([sys.executable, "-c", code, str(config), "--out", str(broken)], stdout=subprocess.PIPE)
    curve = broken / "learning_curve.csv"
    while process.poll() is None and not (curve.exists() and len(curve.read_text().splitlines()) > 2):
        time.sleep(0.002)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    flying = [int(child) for child in children.read_text().split()] if children.exists() else []
    process.kill()
    process.communicate()
    deadline = time.monotonic() + 20.0
    while any(Path(f"/proc/{child}").exists() for child in flying) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(Path(f"/proc/{child}").exists() for child in flying), "the worker outlives the run"
    invoke(config, "--out", broken)
    np.testing.assert_array_equal(members(broken), members(whole))


@pytest.mark.parametrize("workers", [0, 1])
def test_resumed_while_a_generation_flies_equals_uninterrupted(workers: int, tmp_path: Path) -> None:
    whole = Trainer(overlapping(), CPU)
    broken = Trainer(overlapping(), CPU, workers=workers)
    for _ in range(2):
        broken.generation()
    broken.save(tmp_path / "c.npz")
    broken.generation()  # lost
    broken.close()
    resumed = Trainer.resume(tmp_path / "c.npz", overlapping(), CPU, workers=workers)
    for _ in range(2):
        resumed.generation()
    for _ in range(4):
        whole.generation()
    np.testing.assert_array_equal(resumed.members(), whole.members())
    resumed.close()


def test_with_overlap_the_td3_actor_flies_one_generation_late() -> None:
    t = Trainer(overlapping(), CPU)
    t.generation()
    t.generation()
    before = t.learner.actor.parameters().numpy()
    t.generation()
    assert t._ordered is not None
    np.testing.assert_array_equal(t._ordered[0].parameters[-1:], before)
    assert not np.array_equal(t.members()[-1:], before)


def test_a_share_of_the_actors_and_all_exploring_flights_enter_the_shared_memory() -> None:
    t = Trainer(overlapping(), CPU)
    row = t.generation()
    flights = 2 + 1 + 2  # half of four actors, the TD3 actor, its two further flights; one of two evaluations each
    assert row.frames == t.replay.filled <= flights * 100
    assert row.frames > (flights - 1) * 100 * 0.3
    assert row.simulated > 1.5 * row.frames
    assert (t.population.memory.filled[:4] > 0).all()


def test_mutation_falls_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    t = Trainer(overlapping(), CPU)
    seen = []
    evolve = t.population.evolve

    def watched(*arguments: object) -> int | None:
        seen.append(arguments[-1])
        return evolve(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(t.population, "evolve", watched)
    frames = [0]
    for _ in range(3):
        frames += [t.generation().frames]
    expected = [2.47e-2 * (1.0 - 0.8 * min(n / 3000, 1.0)) for n in frames[:-1]]
    assert seen == pytest.approx(expected)


def test_only_the_stored_flights_are_remembered_and_counted() -> None:
    t = trainer(evaluations=3, stored_evaluations=1)
    row = t.generation()
    assert row.frames == t.replay.filled
    assert row.frames <= 5 * 100
    assert row.simulated > 2 * row.frames
    assert row.updates <= 0.2 * row.frames


def test_memory_holds_the_transitions_as_flown() -> None:
    t = trainer(evaluations=1)
    (flights,) = t._fly()
    t._remember(flights)
    rows = t.replay.rows[:100].numpy()
    scale = np.array(t.network.input_scale, dtype=np.float32)
    np.testing.assert_allclose(rows[:, :7], flights.observation[:100, 0, 0] * scale, rtol=1e-6)
    np.testing.assert_allclose(rows[:, 7:10], flights.u[:100, 0, 0])
    np.testing.assert_allclose(rows[:, 10], flights.reward[:100, 0, 0])
    np.testing.assert_allclose(rows[:-1, 11:18], rows[1:, :7])
    assert rows[:, 18].all()


def test_only_the_td3_actor_explores_and_only_where_it_is_remembered() -> None:
    t = trainer(evaluations=2)
    (flights,) = t._fly()
    calm = t.rollouts.fly(t.network, t.members(), np.zeros((2, 101, 3)), np.zeros((100, 2, 3)))
    assert flights.u.shape == calm.u.shape
    jump = np.abs(np.diff(flights.u, axis=0)).mean(axis=(0, 3))
    assert jump[-1, 1] > 0.1
    assert jump[-1, 0] < 0.05
    assert jump[:-1].max() < 0.05


def test_td3_actor_takes_the_least_fit_slot() -> None:
    t = trainer(mutation_probability=0.0)
    t.generation()
    t.generation()
    injected = t.learner.actor.parameters()[0]
    assert sum(torch.equal(actor, injected) for actor in t.population.parameters) == 1


def test_td3_alone_is_a_population_of_none() -> None:
    t = trainer(population=0, evaluations=1)
    row = t.generation()
    assert t.members().shape[0] == 1
    assert row.champion == row.td3 == row.average


def test_discounted_penalty_is_the_discounted_sum_of_the_frames_lost() -> None:
    assert discounted_penalty(300, 0.99) == pytest.approx(-2.0 * sum(0.99**i for i in range(300)))
    assert discounted_penalty(300, 1.0) == pytest.approx(-600.0)
    assert discounted_penalty(0, 0.99) == 0.0


def test_curve_is_written_and_drawn(tmp_path: Path) -> None:
    names = [f for f in Row.__struct_fields__ if f != "generation"]
    rows = [Row(generation=i, **dict.fromkeys(names, -float(i))) for i in (1, 2)]  # type: ignore[arg-type]
    write_csv(tmp_path / "c.csv", rows)
    draw(tmp_path / "c.png", rows, "title")
    assert (tmp_path / "c.csv").read_text().splitlines()[0].startswith("generation,frames,simulated")
    assert (tmp_path / "c.png").stat().st_size > 5000
