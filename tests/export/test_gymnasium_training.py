"""Training on environments from elsewhere: what a run leaves, how it goes on, and DDPG as settings."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from click.testing import CliRunner

from export.network import n_parameters
from export.training import checkpoint
from export.training.cli import train as command
from export.training.config import CONFIGS, EnvironmentSettings, TrainingConfig, as_toml, load
from export.training.gymnasium_rollouts import GymnasiumRollouts
from export.training.gymnasium_run import BANDS, Watched, episodes, load_agents, read_bands
from export.training.memory import Replay
from export.training.networks import actor_network
from export.training.td3 import TD3
from task.errors import UserError

TINY = """
name = "tiny"
frames = 1600
seed = 3

[environment]
id = "Pendulum-v1"
ticks = 40
arguments = {g = 9.0}
validation_episodes = 3
validation_frames = 500

[actor]
width = 8
hidden = 1
input_scale = [1.0, 1.0, 0.2]

[td3]
batch = 16
critic_layers = [8, 8]
buffer = 2000
learning_starts = 200
updates_per_frame = 0.2

[genetic]
population = 4
evaluations = 1
mutation = "proximal"
elite_fraction = 0.25
mutation_batch = 16
memory = 200
crossover_epochs = 1
"""
DDPG = """
policy_delay = 1
twin = false
target_noise = false
"""


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


def test_a_run_leaves_agents_and_a_curve_with_bands(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    output = invoke(tiny, "--out", folder)
    agents = load_agents(folder)
    assert agents.parameters.shape == (5, n_parameters(agents.network))
    assert (agents.network.observation, agents.network.action) == (3, 1)
    assert agents.description.training["frames"] >= 1600
    points = read_bands(folder / BANDS)
    assert [p.frames // 500 for p in points] == [1, 2, 3]
    assert all(p.champion_sd > 0.0 for p in points)
    config = load(str(folder / "config.toml"))
    assert config == load(str(tiny))
    assert "returns of 3 validation episodes" in output

    assert config.environment is not None
    rollouts = GymnasiumRollouts(config.environment)
    returns = rollouts.fly(agents.network, agents.parameters, episodes(config.environment, config.seed)).returns()
    scores = [member.scores["validation_return"] for member in agents.description.members]
    np.testing.assert_allclose(returns.mean(axis=1), scores)
    assert agents.champion == int(np.argmax(scores))


def test_stopped_and_resumed_equals_uninterrupted(tiny: Path, tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    invoke(tiny, "--out", whole)
    invoke(tiny, "--out", broken, "--frames", 700)
    stopped = len(read_bands(broken / BANDS))
    invoke(tiny, "--out", broken)
    assert 0 < stopped < len(read_bands(broken / BANDS))
    np.testing.assert_array_equal(load_agents(broken).parameters, load_agents(whole).parameters)
    assert (broken / BANDS).read_bytes() == (whole / BANDS).read_bytes()


def test_the_learner_alone_trains_too(tmp_path: Path) -> None:
    path = tmp_path / "alone.toml"
    text = TINY[: TINY.index("[genetic]")].replace("updates_per_frame = 0.2", "updates_per_frame = 0.2" + DDPG)
    path.write_text(text + "[genetic]\npopulation = 0\nevaluations = 1\n")
    invoke(path, "--out", tmp_path / "run", "--frames", 600)
    agents = load_agents(tmp_path / "run")
    assert [m.name for m in agents.description.members] == ["td3"]
    (point,) = read_bands(tmp_path / "run" / BANDS)
    assert point.champion == point.learner


def test_further_flights_of_the_learner_leave_the_fittest_actor_in_the_curve(tiny: Path) -> None:
    config = load(str(tiny))
    assert config.environment is not None
    rollouts = Watched(config.environment)
    network = actor_network(config.actor, 3, (2.0,))
    parameters = np.random.default_rng(0).normal(size=(5, n_parameters(network))).astype(np.float32)
    tasks = rollouts.draw(np.random.default_rng(1), 2)
    noise = np.zeros((rollouts.ticks, 2, 1), dtype=np.float32)
    returns = rollouts.fly(network, parameters, tasks, noise).returns().mean(axis=1)
    best = int(returns[:-1].argmax())
    rollouts.fly(network, parameters[-1:], tasks, noise)
    np.testing.assert_array_equal(rollouts.fittest, parameters[[best]])


def test_ddpg_is_td3_without_its_three_additions() -> None:
    settings = load(str(CONFIGS / "lunar_ddpg.toml")).td3
    network = actor_network(load("lunar_ddpg").actor, 3, (1.0,))
    learner = TD3(network, settings, torch.Generator().manual_seed(0), torch.device("cpu"))
    assert learner.critics.count == 1
    replay = Replay(100, 3, 1, torch.device("cpu"))
    rows = torch.randn(100, 9, generator=torch.Generator().manual_seed(1))
    rows[:, -1] = 1.0
    replay.add(rows)
    block = replay.sample(1, settings.batch, torch.Generator().manual_seed(2))
    group = type(block)(*(tensor[0] for tensor in block))
    u = learner._actor_target(group.next_state)[0]
    q = learner._critics_target(torch.cat([group.next_state, u], 1))[0]
    expected = group.reward + settings.gamma * q
    steps = learner.critics.steps
    learner.learn(replay, 1, torch.Generator().manual_seed(2))
    assert learner.critics.steps == steps + 1
    assert learner.actor.steps == 1  # no delay
    learner = TD3(network, settings, torch.Generator().manual_seed(0), torch.device("cpu"))
    y = learner._targets(group, 0.0 * torch.randn(settings.batch, 1))
    torch.testing.assert_close(y, expected)


def test_a_setting_that_is_newer_than_a_checkpoint_had_its_default(tmp_path: Path) -> None:
    config = TrainingConfig(name="a", frames=1)
    saved = msgspec.json.decode(msgspec.json.encode(config))
    del saved["td3"]["twin"], saved["environment"]
    checkpoint.require_same(tmp_path, saved, config)
    other = msgspec.structs.replace(config, environment=EnvironmentSettings(id="Pendulum-v1"))
    with pytest.raises(UserError, match="environment"):
        checkpoint.require_same(tmp_path, saved, other)
    with pytest.raises(UserError, match="another version"):
        checkpoint.require_same(tmp_path, {**saved, "colour": 1}, config)


def test_a_configuration_with_an_environment_survives_toml(tiny: Path, tmp_path: Path) -> None:
    config = load(str(tiny))
    again = tmp_path / "again.toml"
    again.write_text(as_toml(config))
    assert load(str(again)) == config
    assert config.environment is not None
    assert config.environment.arguments == {"g": 9.0}


def test_agents_that_are_not_there_are_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no finished run"):
        load_agents(tmp_path / "nothing")
    (tmp_path / BANDS).write_text("frames,champion\n1,2\n")
    with pytest.raises(UserError, match="not a curve"):
        read_bands(tmp_path / BANDS)
