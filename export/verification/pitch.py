"""Pitch alone, for the verification of the gradient learner (thesis section 9.3).

Importing this registers ``understudy/Pitch-v0``; ``export.verification.pitch:understudy/Pitch-v0`` does both.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from export.training.rollouts import discounted_penalty
from sim_bridge.conditions import NOMINAL
from sim_bridge.plant import Plant
from task.limits import ACTION_HIGH, ACTION_LOW
from task.reference import Family, cosine_steps, n_samples
from task.reward import terminated, tracking_reward
from task.state import ACTION, N_REFERENCE, REFERENCE, STATE

ID = f"{__name__}:understudy/Pitch-v0"
"""What ``gymnasium.make`` takes, wherever it is called."""

DURATION = 20.0
"""Length of an episode [s]."""
BOUND = np.array([4.0, 10.0, 4.0, 200.0], dtype=np.float32)
"""Bound of the observation space [rad, rad/s, rad, m/s]; an episode is over long before."""
GAMMA = 0.99
"""Discount of the penalty of a lost flight."""
REFERENCES = Family(np.deg2rad(25.0), 0.0, 5, 1 / 6, None)
"""As the pitch of the training references (``task.reference``); the thesis's section 9.3 names no amplitude."""


def pitch_reference(rng: np.random.Generator, theta_trim: float, duration: float = DURATION) -> np.ndarray:
    """Draw a sequence of cosine-smoothed steps in pitch about trim, shape (T,) [rad]."""
    levels = rng.uniform(-REFERENCES.theta, REFERENCES.theta, REFERENCES.blocks + 1)
    return theta_trim + cosine_steps(levels, duration, duration * REFERENCES.smoothing)


class PitchEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Track a pitch reference with the elevator; aileron and rudder stay at zero.

    Observation (4,) float32: theta_e = theta_ref - theta [rad], q [rad/s], alpha [rad] and V - V_trim [m/s]; the
    thesis gives V itself. Action (1,) float32: absolute elevator deflection [rad]. Reward: eq. 12 with no error in
    roll and sideslip, so a third of what pitch can cost there, and eq. 13 when the flight is lost, discounted as the
    critic of eq. 1 would have summed it (:func:`export.training.rollouts.discounted_penalty`).
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self) -> None:
        """Fly from the nominal trim."""
        self.observation_space = gymnasium.spaces.Box(-BOUND, BOUND, dtype=np.float32)
        low, high = (limit[[ACTION.de]].astype(np.float32) for limit in (ACTION_LOW, ACTION_HIGH))
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        self.plant = Plant()
        self.reference = np.zeros(1)
        self._command = np.zeros(len(ACTION))
        self._error = np.zeros(N_REFERENCE)
        self._k = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start at trim; ``options["reference"]`` (T,) [rad] replaces the random one."""
        super().reset(seed=seed)
        x = self.plant.reset(NOMINAL)
        trim = float(self.plant.trim.x[STATE.theta])
        given = (options or {}).get("reference")
        self.reference = pitch_reference(self.np_random, trim) if given is None else np.asarray(given, dtype=float)
        self._k = 0
        return self._look(x), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold an elevator deflection (1,) [rad] for one sample; beyond the action space it is clipped."""
        self._command[ACTION.de] = np.clip(action[0], ACTION_LOW[ACTION.de], ACTION_HIGH[ACTION.de])
        x = self.plant.step(self._command)
        self._k += 1
        lost = bool(terminated(x))
        s = self._look(x)
        self._error[REFERENCE.theta] = s[0]
        reward = float(tracking_reward(self._error))
        if lost:
            reward = -1.0 / 3.0 + discounted_penalty(len(self.reference) - self._k, GAMMA)
            s = np.nan_to_num(s, nan=0.0, posinf=0.0, neginf=0.0)
        return s, reward, lost, not lost and self._k >= len(self.reference), {}

    def _look(self, x: np.ndarray) -> np.ndarray:
        wanted = self.reference[min(self._k, len(self.reference) - 1)]
        speed = x[STATE.V] - self.plant.trim.x[STATE.V]
        return np.array([wanted - x[STATE.theta], x[STATE.q], x[STATE.alpha], speed], dtype=np.float32)


gymnasium.register(ID.split(":")[1], entry_point=f"{__name__}:PitchEnv", max_episode_steps=n_samples(DURATION))
