"""Pitch alone, the elevator step and the PIDs: the verifications of chapter 9 in small."""

from __future__ import annotations

import math
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner

from bench.verification import command as verification
from bench.verification.command import Tracked, fit_phugoid, fly_pids, pitch_pid
from export.training.cli import train
from export.training.rollouts import discounted_penalty
from export.verification.pitch import DURATION, GAMMA, ID, PitchEnv, pitch_reference
from sim_bridge.plant import Plant
from task import results
from task.limits import DEFLECTION_LIMIT, DT
from task.reference import BASE_THETA
from task.reward import REWARD_SCALE
from task.state import ACTION, REFERENCE, STATE

CONFIG = f"""
name = "pitch_td3"
frames = 300
seed = 3
[environment]
id = "{ID}"
ticks = 100
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
population = 0
evaluations = 1
"""


def test_pitch_is_the_plant_with_the_elevator_alone() -> None:
    env, plant = PitchEnv(), Plant()
    seen, _ = env.reset(seed=1)
    x = plant.reset()
    trim = plant.trim
    assert seen[0] == pytest.approx(env.reference[0] - x[STATE.theta], abs=1e-6)
    command = np.zeros(3)
    for k in range(50):
        command[ACTION.de] = trim.action[ACTION.de] + 0.01 * math.sin(0.2 * k)
        seen, reward, lost, ended, _ = env.step(command[[ACTION.de]])
        x = plant.step(command)
        error = env.reference[k + 1] - x[STATE.theta]
        np.testing.assert_allclose(seen, [error, x[STATE.q], x[STATE.alpha], x[STATE.V] - trim.x[STATE.V]], atol=1e-5)
        assert reward == pytest.approx(-min(REWARD_SCALE[REFERENCE.theta] * abs(error), 1.0) / 3.0, abs=1e-6)
        assert not lost
        assert not ended


def test_a_lost_flight_pays_for_the_time_that_is_left() -> None:
    env = gymnasium.make(ID, disable_env_checker=True)
    env.reset(seed=1)
    lost, k, reward = False, 0, 0.0
    while not lost:
        seen, reward, lost, truncated, _ = env.step(np.array([-DEFLECTION_LIMIT], dtype=np.float32))
        k += 1
        assert not truncated
    assert np.isfinite(seen).all()
    assert reward == pytest.approx(discounted_penalty(round(DURATION / DT) - k, GAMMA) - 1.0 / 3.0)


def test_references_are_drawn_about_trim() -> None:
    drawn = np.stack([pitch_reference(np.random.default_rng(i), 0.1) for i in range(50)]) - 0.1
    assert drawn.shape == (50, 2000)
    assert math.radians(20.0) < np.abs(drawn).max() <= math.radians(25.0) + 1e-9
    assert np.abs(np.diff(drawn)).max() < 0.005


def test_the_fit_finds_a_damped_oscillation() -> None:
    t = np.arange(8_000) * DT
    omega, zeta = 2.0 * math.pi / 47.0, 0.1
    decay = zeta * omega / math.sqrt(1.0 - zeta**2)
    found = fit_phugoid(94.0 - 0.01 * t + 5.0 * np.exp(-decay * t) * np.sin(omega * t + 1.0))
    assert found.period == pytest.approx(47.0, rel=1e-3)
    assert found.damping == pytest.approx(zeta, rel=1e-2)
    assert found.residual < 1e-3
    assert found.lanchester == pytest.approx(math.pi * math.sqrt(2.0) * found.speed / 9.80665)


def test_overshoot_is_measured_beyond_the_level() -> None:
    flown = fly_pids()
    assert flown.overshoot(REFERENCE.theta, BASE_THETA) < 0.05
    states = flown.states.copy()
    block = len(states) // 5
    states[block + 1200, STATE.theta] = flown.reference[2 * block - 1, REFERENCE.theta] + math.radians(3.0)
    beyond = Tracked(states, flown.commands, flown.reference).overshoot(REFERENCE.theta, BASE_THETA)
    assert beyond == pytest.approx(3.0 / 12.0, rel=1e-3)


def test_the_pitch_pid_tracks() -> None:
    returns, error = pitch_pid(np.array([5]))
    assert -20.0 < returns[0] < 0.0
    assert error[0] < math.radians(1.0)


def test_the_verification_in_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pitch.toml").write_text(CONFIG)
    (tmp_path / "pendulum.toml").write_text(CONFIG.replace(ID, "Pendulum-v1"))
    for config, out in (("pitch", "pitch_td3"), ("pendulum", "pendulum_ddpg"), ("pendulum", "pendulum_pderl")):
        run = CliRunner().invoke(train, [f"{config}.toml", "--out", f"runs/{out}"], catch_exceptions=False)
        assert run.exit_code == 0, run.output
    done = CliRunner().invoke(verification.main, ["--episodes", "1"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    measured = results.read(tmp_path / "results" / "verification.json")
    holds = {claim.claim: claim.holds for claim in measured.claims}
    assert holds["elevator +0.5 deg: pitch one second later"]
    assert holds["elevator +0.5 deg: period of the phugoid over Lanchester's"]
    assert holds["PIDs: overshoot of the worst step in theta, of its size"]
    assert not holds["pendulum, DDPG: mean return"]
    assert not holds["pitch-only TD3: mean return of 20 s"]  # it has learnt nothing in three seconds of flight
    assert len(list((tmp_path / "docs" / "img").glob("verification_*.png"))) == 4
