"""The attitude-tracking task as a Gymnasium environment, for learners from elsewhere."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from sim_bridge.conditions import NOMINAL, FlightCondition
from sim_bridge.plant import Plant
from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.observation import observation, tracking_error
from task.reference import FamilyName, random_reference
from task.reward import crash_penalty, terminated, tracking_reward, unsafe
from task.state import N_OBSERVATION, STATE

OBSERVATION_BOUND = 30.0
"""Bound of the observation space [rad, rad/s], as published; a flight is over long before."""


class AttitudeEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Track theta, phi and beta (thesis section III.A).

    Observation (7,) float32: s of eq. 11. Action (3,) float32: absolute deflections [rad] (eq. 10).
    Reward: eq. 12 for the state that follows, with eq. 13 when the flight is lost. ``info`` holds the
    state ``x`` (12,), the ``reference`` (3,) [rad] that s is measured against and ``unsafe`` (eq. 14).
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self, duration: float = 20.0, family: FamilyName = "training", condition: FlightCondition = NOMINAL
    ) -> None:
        """Fly ``duration`` [s] from trim on random references of ``family``."""
        bound = np.full(N_OBSERVATION, OBSERVATION_BOUND, dtype=np.float32)
        self.observation_space = gymnasium.spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = gymnasium.spaces.Box(
            ACTION_LOW.astype(np.float32), ACTION_HIGH.astype(np.float32), dtype=np.float32
        )
        self.duration, self.family, self.condition = duration, family, condition
        self.plant = Plant()
        self._reference = np.zeros((1, 3))
        self._k = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start at trim; ``options["reference"]`` (T, 3) [rad] replaces the random one."""
        super().reset(seed=seed)
        x = self.plant.reset(self.condition)
        given = (options or {}).get("reference")
        if given is None:
            theta_trim = float(self.plant.trim.x[STATE.theta])
            given = random_reference(self.np_random, self.duration, theta_trim, self.family)
        self._reference = np.asarray(given, dtype=float)
        self._k = 0
        return self._look(x)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold deflections (3,) [rad] for one sample; beyond the action space they are clipped."""
        x = self.plant.step(np.clip(np.asarray(action, dtype=float), ACTION_LOW, ACTION_HIGH))
        self._k += 1
        lost = bool(terminated(x))
        seen, info = self._look(x)
        reward = float(tracking_reward(tracking_error(x, info["reference"])))
        if lost:
            reward += float(crash_penalty((len(self._reference) - self._k) * DT))
        return seen, reward, lost, not lost and self._k >= len(self._reference), info

    def _look(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
        reference = self._reference[min(self._k, len(self._reference) - 1)]
        seen = observation(x, reference).astype(np.float32).clip(-OBSERVATION_BOUND, OBSERVATION_BOUND)
        return seen, {"x": x.copy(), "reference": reference.copy(), "unsafe": bool(unsafe(x))}
