"""Any Gymnasium environment with continuous actions as the world that a trainer learns in."""

from __future__ import annotations

import traceback
from typing import Any

import gymnasium
import numpy as np

from export.network import Network
from export.training.acting import Cast
from export.training.config import EnvironmentSettings
from export.training.flights import Flights
from task.errors import UserError

SEEDS = 2**31
"""Seeds of episodes are drawn below this."""


class GymnasiumRollouts:
    """Environments that step side by side; tasks are seeds of episodes (E,) int64, common to all policies.

    A policy's u in [-1, 1] spans the box of actions. A flight is ``lost`` where the environment says that it is
    terminated, be it for good or ill: nothing follows that a critic could hope for. A truncated one goes on for
    the critic. ``unsafe`` stays empty: an environment states no safety cost (eq. 14).
    """

    def __init__(self, settings: EnvironmentSettings) -> None:
        """Make one environment, others as they are needed; raise UserError where policies could not fly it."""
        self.settings = settings
        self.envs = [self._make()]
        seen, acted = self.envs[0].observation_space, self.envs[0].action_space
        name = f"environment '{settings.id}'"
        if not isinstance(acted, gymnasium.spaces.Box) or len(acted.shape) != 1 or not acted.is_bounded():
            raise UserError(f"{name}: expected continuous actions in a bounded box of one dimension, got {acted}")
        if not isinstance(seen, gymnasium.spaces.Box) or len(seen.shape) != 1:
            raise UserError(
                f"{name}: expected observations in a box of one dimension, got {seen}; wrap it in FlattenObservation"
            )
        limit = self.envs[0].spec.max_episode_steps if self.envs[0].spec else None
        if not (settings.ticks or limit):
            raise UserError(f"{name}: it has no time limit of its own; set environment.ticks")
        self.observation: int = seen.shape[0]
        self.ticks: int = settings.ticks or int(limit or 0)
        self._middle = (acted.high.astype(float) + acted.low) / 2.0
        self._half = (acted.high.astype(float) - acted.low) / 2.0
        self.action_scale: tuple[float, ...] = tuple(self._half.tolist())
        self._dtype = acted.dtype

    def _make(self) -> gymnasium.Env[np.ndarray, np.ndarray]:
        arguments: dict[str, Any] = dict(self.settings.arguments)
        try:
            return gymnasium.make(self.settings.id, disable_env_checker=True, **arguments)
        except Exception as error:  # an environment's constructor may raise anything
            raise self._failed("gymnasium cannot make it", error) from None

    def _failed(self, what: str, error: Exception) -> UserError:
        """Return in one line what an environment raised, and where."""
        reason = str(error).strip().splitlines()[0].removesuffix(".") if str(error).strip() else "no reason given"
        if not isinstance(error, (gymnasium.error.Error, ImportError)):
            place = traceback.extract_tb(error.__traceback__)[-1]
            reason = f"{type(error).__name__}: {reason} ({place.filename}, line {place.lineno})"
        return UserError(f"environment '{self.settings.id}': {what}: {reason}")

    def _reset(self, env: gymnasium.Env[np.ndarray, np.ndarray], seed: int) -> np.ndarray:
        """Start an episode; return its first observation."""
        try:
            seen = np.asarray(env.reset(seed=seed)[0])
        except Exception as error:
            raise self._failed("reset failed", error) from None
        if seen.shape != (self.observation,):
            raise UserError(
                f"environment '{self.settings.id}': expected observations of shape {(self.observation,)}, as its "
                f"observation_space says, got {seen.shape}"
            )
        return seen

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return seeds of ``count`` episodes, (count,) int64."""
        return rng.integers(SEEDS, size=count)

    def fly(
        self, network: Network, parameters: np.ndarray, tasks: np.ndarray, noise: np.ndarray | None = None
    ) -> Flights:
        """Fly P policies (P, K) through the episodes of the seeds ``tasks`` (E,), P * E environments in step.

        noise: (ticks, E, action) added to the last policy's u; every u is then cut to [-1, 1]. Raises UserError when
        an environment returns what is not finite.
        """
        P, E, T = len(parameters), len(tasks), self.ticks
        self.envs += [self._make() for _ in range(P * E - len(self.envs))]
        cast = Cast(network, np.ascontiguousarray(parameters, dtype=np.float32), E)
        s = np.zeros((T + 1, P * E, self.observation), dtype=np.float32)
        u = np.zeros((T, P, E, len(self.action_scale)), dtype=np.float32)
        reward = np.zeros((T, P * E), dtype=np.float32)
        length = np.full(P * E, T)
        lost = np.zeros(P * E, dtype=bool)
        steps = [env.step for env in self.envs[: P * E]]
        for i in range(P * E):
            s[0, i] = self._reset(self.envs[i], int(tasks[i % E]))
        flying = list(range(P * E))
        for k in range(T):
            u[k] = cast(s[k].reshape(P, E, -1))
            if noise is not None:
                u[k, -1] += noise[k]
            np.clip(u[k], -1.0, 1.0, out=u[k])
            a = (self._middle + self._half * u[k].reshape(P * E, -1)).astype(self._dtype)
            ended = []
            try:
                for i in flying:
                    s[k + 1, i], reward[k, i], terminated, truncated, _ = steps[i](a[i])
                    if terminated or truncated:
                        lost[i], length[i] = terminated, k + 1
                        ended.append(i)
            except Exception as error:  # whatever the environment raises, or returns that is of no such shape
                raise self._failed(f"step {k + 1} of an episode failed", error) from None
            if ended:
                flying = [i for i in flying if i not in ended]
                if not flying:
                    break
        if not (np.isfinite(reward).all() and np.isfinite(s).all()):
            what = "an observation" if np.isfinite(reward).all() else "a reward"
            raise UserError(f"environment '{self.settings.id}': {what} was not finite; correct the environment")
        danger = np.zeros((T, P, E), dtype=bool)
        shape = (P, E)
        return Flights(
            s.reshape(T + 1, *shape, -1),
            u,
            reward.reshape(T, *shape),
            danger,
            length.reshape(shape),
            lost.reshape(shape),
        )

    def learnt_reward(self, flights: Flights, gamma: float) -> np.ndarray:
        """Return the environment's rewards (T, P, E) as they are."""
        return flights.reward

    def attribute(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Return what each environment of the last flights calls ``name``, reshaped to (*shape, ...); shape is (P, E).

        For what an environment knows beyond its observation, such as where a lander touched down.
        """
        values = np.array([env.get_wrapper_attr(name) for env in self.envs[: shape[0] * shape[1]]])
        return values.reshape(*shape, *values.shape[1:])
