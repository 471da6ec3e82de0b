"""Environments side by side: seeds, scales, ends, and what cannot be flown."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from export.network import Layer, Network, forward, n_parameters, unflatten
from export.training.config import EnvironmentSettings
from export.training.gymnasium_rollouts import GymnasiumRollouts
from task.errors import UserError


class Countdown(gymnasium.Env[np.ndarray, np.ndarray]):
    """Ends by its own verdict after ``seed % 7 + 1`` steps, or is cut after ``cut``; pays what it is told to do."""

    def __init__(self, cut: int = 5, unsound: bool = False) -> None:
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), dtype=np.float32)
        self.action_space = gymnasium.spaces.Box(np.array([2.0], np.float32), np.array([6.0], np.float32))
        self.cut, self.unsound = cut, unsound

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self.k, self.end = 0, (seed or 0) % 7 + 1
        return self._look(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        self.k += 1
        reward = np.nan if self.unsound else float(action[0])
        return self._look(), reward, self.k >= self.end, self.k >= self.cut, {}

    def _look(self) -> np.ndarray:
        return np.array([self.k, self.end], dtype=np.float32)


gymnasium.register("test/Countdown-v0", entry_point=Countdown)
COUNTDOWN = EnvironmentSettings(id="test/Countdown-v0", ticks=6)


def bias_only(u: float, rollouts: GymnasiumRollouts) -> tuple[Network, np.ndarray]:
    """Return an actor whose output is ``u`` everywhere."""
    n, m = rollouts.observation, len(rollouts.action_scale)
    network = Network(
        layers=(Layer(units=m, activation="linear"),), observation=n, action=m, input_scale=(1.0,) * n,
        action_scale=rollouts.action_scale, action_offset=(0.0,) * m,
    )  # fmt: skip
    parameters = np.zeros((1, n_parameters(network)), dtype=np.float32)
    parameters[0, n * m :] = u
    return network, parameters


def test_episodes_of_unlike_length_end_as_they_should() -> None:
    rollouts = GymnasiumRollouts(COUNTDOWN)
    network, actor = bias_only(0.5, rollouts)
    seeds = np.array([0, 2, 4, 6])
    flights = rollouts.fly(network, np.repeat(actor, 2, axis=0), seeds)
    assert flights.length.tolist() == [[1, 3, 5, 5]] * 2
    assert flights.lost.tolist() == [[True, True, True, False]] * 2  # the last was cut by the clock
    np.testing.assert_allclose(flights.returns(), 5.0 * flights.length)  # u = 0.5 is 5 in a box from 2 to 6
    for e, n in enumerate((1, 3, 5, 5)):
        np.testing.assert_array_equal(flights.observation[: n + 1, 0, e, 0], np.arange(n + 1))
        assert not flights.reward[n:, 0, e].any()
    assert not flights.unsafe.any()


def test_noise_is_for_the_last_policy_and_actions_stay_in_the_box() -> None:
    rollouts = GymnasiumRollouts(COUNTDOWN)
    network, actor = bias_only(0.5, rollouts)
    noise = np.full((6, 1, 1), 3.0, dtype=np.float32)
    flights = rollouts.fly(network, np.repeat(actor, 2, axis=0), np.array([3]), noise)
    assert flights.reward[0, :, 0].tolist() == [5.0, 6.0]
    assert flights.u[0, :, 0, 0].tolist() == [0.5, 1.0]


def test_a_batch_flies_as_each_policy_alone() -> None:
    rollouts = GymnasiumRollouts(EnvironmentSettings(id="Pendulum-v1", ticks=30))
    network = Network(
        layers=(Layer(units=8), Layer(units=1)), observation=3, action=1, input_scale=(1.0, 2.0, 0.5),
        action_scale=(1.0,), action_offset=(0.0,),
    )  # fmt: skip
    parameters = np.random.default_rng(0).normal(size=(3, n_parameters(network))).astype(np.float32)
    seeds = rollouts.draw(np.random.default_rng(1), 2)
    flights = rollouts.fly(network, parameters, seeds)
    assert flights.length.tolist() == [[30, 30]] * 3
    assert not flights.lost.any()
    env = gymnasium.make("Pendulum-v1")
    for p, e in np.ndindex(3, 2):
        s, _ = env.reset(seed=int(seeds[e]))
        total = 0.0
        for _ in range(30):
            u = forward(network, unflatten(network, parameters[[p]]), s)[0]
            s, reward, *_ = env.step((2.0 * u).astype(np.float32))
            total += float(reward)
        assert flights.returns()[p, e] == pytest.approx(total, rel=1e-3)
    np.testing.assert_array_equal(flights.observation[0, 0], flights.observation[0, 2])  # the same start for all


def test_seeds_are_a_function_of_the_stream() -> None:
    rollouts = GymnasiumRollouts(COUNTDOWN)
    one, two = (rollouts.draw(np.random.default_rng(5), 4) for _ in range(2))
    assert one.tolist() == two.tolist()
    assert len(set(one.tolist())) == 4


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (EnvironmentSettings(id="CartPole-v1"), "expected continuous actions in a bounded box"),
        (EnvironmentSettings(id="NoSuch-v0"), "gymnasium cannot make it"),
        (EnvironmentSettings(id="no.such.module:NoSuch-v0"), "gymnasium cannot make it"),
        (EnvironmentSettings(id="Pendulum-v1", arguments={"weight": 3.0}), "gymnasium cannot make it"),
        (EnvironmentSettings(id="test/Countdown-v0"), "set environment.ticks"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(settings: EnvironmentSettings, message: str) -> None:
    with pytest.raises(UserError, match=message) as refused:
        GymnasiumRollouts(settings)
    assert "\n" not in str(refused.value)


def test_a_reward_that_is_no_number_is_refused() -> None:
    rollouts = GymnasiumRollouts(EnvironmentSettings(id="test/Countdown-v0", ticks=6, arguments={"unsound": True}))
    with pytest.raises(UserError, match="not finite"):
        rollouts.fly(*bias_only(0.0, rollouts), np.array([1]))


class Broken(Countdown):
    """Fails where it is told to."""

    def __init__(self, where: str) -> None:
        if where == "made":
            raise AttributeError("no display\nat all")
        super().__init__()
        self.where = where

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        if self.where == "reset":
            raise KeyError("seed")
        seen, info = super().reset(seed=seed)
        return (seen[:1] if self.where == "seen" else seen), info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if self.where == "step":
            raise RuntimeError("the engine is on fire")
        seen, *rest = super().step(action)
        return (np.zeros(3, dtype=np.float32) if self.where == "grown" else seen), *rest


gymnasium.register("test/Broken-v0", entry_point=Broken)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("made", r"gymnasium cannot make it: AttributeError: no display \(.*test_gymnasium_rollouts\.py, line \d+\)"),
        ("reset", r"reset failed: KeyError: 'seed' \(.*test_gymnasium_rollouts\.py, line \d+\)"),
        ("seen", r"expected observations of shape \(2,\), as its observation_space says, got \(1,\)"),
        ("step", r"step 1 of an episode failed: RuntimeError: the engine is on fire \(.*test_gymnasium_rollouts\.py"),
        ("grown", r"step 1 of an episode failed: ValueError: could not broadcast"),
    ],
)
def test_an_environment_that_fails_is_one_line(where: str, message: str) -> None:
    def fly() -> None:
        rollouts = GymnasiumRollouts(EnvironmentSettings(id="test/Broken-v0", ticks=6, arguments={"where": where}))
        rollouts.fly(*bias_only(0.0, rollouts), np.array([1]))

    with pytest.raises(UserError, match=rf"environment 'test/Broken-v0': {message}") as refused:
        fly()
    assert "\n" not in str(refused.value)
