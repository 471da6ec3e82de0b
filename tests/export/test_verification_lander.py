"""The lander of chapter 4: reward, faults, touchdown, archive, and the whole measurement in small."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner

from export.training.cli import train
from export.training.config import EnvironmentSettings
from export.training.gymnasium_rollouts import GymnasiumRollouts
from export.verification import archive
from export.verification.archive import LINEAR, ArchiveSettings, Search, linear, load_elites
from export.verification.lander import ANGLE, ID, LEFT_LEG, POSITION_NOISE, RIGHT_LEG, VY, X, Y, thrust
from export.verification.measure import command as measure
from export.verification.trials import Cast, Grounds, choose, worst_case
from task import results
from task.errors import UserError

ROOT = Path(__file__).parents[2]


def play(env: gymnasium.Env[np.ndarray, np.ndarray], actions: np.ndarray, seed: int = 4) -> tuple[np.ndarray, ...]:
    """Return observations, rewards and the last verdict of an episode under given actions."""
    seen, rewards, over = [env.reset(seed=seed)[0]], [], False
    for action in actions:
        s, reward, over, _, _ = env.step(action)
        seen.append(s)
        rewards.append(reward)
        if over:
            break
    return np.array(seen), np.array(rewards), np.array(over)


def lander(fault: str = "none") -> gymnasium.Env[np.ndarray, np.ndarray]:
    return gymnasium.make(ID, disable_env_checker=True, fault=fault)


def plain() -> gymnasium.Env[np.ndarray, np.ndarray]:
    return gymnasium.make("LunarLander-v3", continuous=True)


FALL = np.zeros((300, 2), dtype=np.float32)


def test_legs_earn_nothing_and_all_else_is_lunar_lander() -> None:
    s, reward, over = play(lander(), FALL)
    s0, reward0, _ = play(plain(), FALL)
    assert over
    np.testing.assert_array_equal(s, s0)
    legs = s[:, LEFT_LEG] + s[:, RIGHT_LEG]
    assert legs.any()
    bonus = 10.0 * np.diff(legs)
    bonus[-1] = 0.0  # the verdict is bare
    np.testing.assert_allclose(reward, reward0 - bonus, atol=1e-4)
    assert reward[-1] == -100.0


def test_the_impact_is_that_of_the_first_touch() -> None:
    env = lander()
    s, _, _ = play(env, FALL)
    touch = int(np.flatnonzero((s[:, LEFT_LEG] + s[:, RIGHT_LEG]) > 0.0)[0])
    assert env.get_wrapper_attr("impact") == pytest.approx((s[touch, X], s[touch, VY]))
    assert touch < len(s) - 1


def test_noise_is_on_the_observed_position_alone() -> None:
    env = lander("noisy_position")
    noisy, reward, _ = play(env, FALL)
    again, _, _ = play(env, FALL)
    true, reward0, _ = play(lander(), FALL)
    np.testing.assert_array_equal(noisy, again)
    np.testing.assert_array_equal(noisy[:, VY:ANGLE], true[:, VY:ANGLE])
    np.testing.assert_allclose(reward, reward0)
    error = (noisy - true)[:, [X, Y]]
    assert error.std() == pytest.approx(POSITION_NOISE, rel=0.2)
    assert abs(error.mean()) < 0.02
    healthy = lander()
    play(healthy, FALL)
    assert env.get_wrapper_attr("impact") == healthy.get_wrapper_attr("impact")  # of the lander, not of its sensors


def test_the_weak_engine_gives_three_quarters_and_burns_the_whole() -> None:
    full, part = (np.tile(np.array([a, 0.0], dtype=np.float32), (40, 1)) for a in (1.0, 0.5))
    assert thrust(0.5) == 0.75
    weak, reward, _ = play(lander("weak_engine"), full)
    known, reward0, _ = play(plain(), part)
    np.testing.assert_allclose(weak, known)
    np.testing.assert_allclose(reward, reward0 - 0.3 * 0.25, atol=1e-6)
    below, reward, _ = play(lander("weak_engine"), part)
    np.testing.assert_allclose(below, known)
    np.testing.assert_allclose(reward, reward0, atol=1e-6)


def test_an_unknown_fault_is_refused() -> None:
    with pytest.raises(UserError, match="expected one of none, noisy_position, weak_engine"):
        GymnasiumRollouts(EnvironmentSettings(id=ID, arguments={"fault": "rust"}))


def test_a_linear_policy_is_w_times_s() -> None:
    weights = np.random.default_rng(0).normal(size=(2, 2, 8)) / 4.0
    rollouts = GymnasiumRollouts(EnvironmentSettings(id=ID, ticks=20))
    flights = rollouts.fly(LINEAR, linear(weights), np.array([1]))
    expected = np.clip(np.einsum("paj,tpj->tpa", weights, flights.observation[:20, :, 0]), -1.0, 1.0)
    np.testing.assert_allclose(flights.u[:, :, 0], expected, atol=1e-5)


def test_a_resumed_archive_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    settings = ArchiveSettings(emitters=2, batch=4, cells=(10, 10))
    whole = Search(settings)
    whole.iterate()
    whole.save(tmp_path)
    again = Search.resume(tmp_path, settings)
    for search in (whole, again):
        search.iterate()
    assert again.progress.iterations == 2
    assert again.progress.frames == whole.progress.frames
    np.testing.assert_array_equal(again.elites().weights, whole.elites().weights)
    with pytest.raises(UserError, match="--fresh"):
        Search.resume(tmp_path, ArchiveSettings(emitters=2, batch=4))
    elites = load_elites(tmp_path)
    rollouts = GymnasiumRollouts(EnvironmentSettings(id=ID))
    flights = rollouts.fly(LINEAR, elites.parameters(), np.array([settings.episode]))
    np.testing.assert_allclose(flights.returns()[:, 0], elites.returns, rtol=1e-4)


def test_a_pick_is_the_policy_that_earns_most_in_its_trials(tmp_path: Path) -> None:
    grounds = Grounds(tmp_path)
    burn = np.zeros((3, 2, 8))
    burn[1, 0, 1] = 1.0  # the main engine on while high: out of the screen, slowly and dearly
    cast = Cast(LINEAR, linear(burn))
    choice = choose(grounds, cast, "weak_engine", stream=1, first=2, then=3, keep=2)
    everybody = grounds.land(cast, "weak_engine", np.random.default_rng(2).integers(2**31, size=3)).returns.mean(axis=1)
    assert everybody[choice.member] == pytest.approx(everybody.max())
    assert choice.episodes == 3 * 2 + 2 * 3
    assert worst_case(np.array([0.0, 2.0])) == 0.5
    remembered = sorted(tmp_path.iterdir())
    again = choose(Grounds(tmp_path), cast, "weak_engine", stream=1, first=2, then=3, keep=2)
    assert again == choice
    assert sorted(tmp_path.iterdir()) == remembered


TINY = """
name = "tiny"
frames = 300
seed = 3
[environment]
id = "export.verification.lander:understudy/Lander-v0"
validation_episodes = 2
validation_frames = 100
[actor]
width = 8
hidden = 1
[td3]
batch = 16
critic_layers = [8]
buffer = 2000
learning_starts = 100
updates_per_frame = 0.1
[genetic]
evaluations = 1
mutation = "proximal"
crossover_epochs = 1
"""


def test_the_measurement_in_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, population in (("lunar_pderl", 3), ("lunar_ddpg", 0)):
        config = tmp_path / f"{name}.toml"
        config.write_text(TINY + f"population = {population}\n")
        run = CliRunner().invoke(train, [str(config), "--out", f"runs/{name}"], catch_exceptions=False)
        assert run.exit_code == 0, run.output
    folder = tmp_path / "runs" / "lunar_archive"
    folder.mkdir()
    search = Search(ArchiveSettings(emitters=1, batch=5))
    search.iterate()
    search.save(folder)
    done = CliRunner().invoke(measure.main, ["--episodes", "2"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    measured = results.read(tmp_path / "results" / "lunar_lander.json")
    cases, repertoires, picks = measured.tables
    assert [row[0] for row in cases.rows[::3]] == ["PDERL champion", "DDPG", "CMA-ME champion"]
    assert len(repertoires.rows) == 6
    assert repertoires.rows[0][2] == 3
    assert len(picks.rows) == 4
    assert {p.name for p in (tmp_path / "docs" / "img").iterdir()} == {
        f"lunar_{what}.png" for what in ("learning", "archive", "faults", "behaviour")
    }


def test_an_archive_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no archive of landers"):
        load_elites(tmp_path)
    (tmp_path / archive.CHECKPOINT).write_bytes(b"no pickle")
    with pytest.raises(UserError, match="not a checkpoint"):
        Search.resume(tmp_path, ArchiveSettings())
    (tmp_path / archive.ELITES).write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(UserError, match="no archive of landers"):
        load_elites(tmp_path)


def test_the_archive_s_command_says_what_is_wrong_in_one_line(tmp_path: Path) -> None:
    (tmp_path / archive.CHECKPOINT).write_bytes(b"no pickle")
    command = [sys.executable, "-m", "export.verification.archive", "--iterations", "1", "--out", tmp_path]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch(
        r"understudy: .*scheduler\.pickle: not a checkpoint of this search: .*use --fresh\n", done.stderr
    )


def test_landings_that_are_damaged_are_named(tmp_path: Path) -> None:
    cast, tasks = Cast(LINEAR, linear(np.zeros((1, 2, 8)))), np.array([3])
    Grounds(tmp_path).land(cast, "none", tasks)
    (kept,) = tmp_path.iterdir()
    kept.write_bytes(kept.read_bytes()[:100])
    with pytest.raises(UserError, match=rf"{kept.name}: holds no flights; delete it"):
        Grounds(tmp_path).land(cast, "none", tasks)


def test_a_noisy_lander_flies_without_a_seed_too() -> None:
    env = lander("noisy_position")
    s, _ = env.reset()
    assert np.isfinite(env.step(np.zeros(2, dtype=np.float32))[0]).all()
    assert np.isfinite(s).all()
