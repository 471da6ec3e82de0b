"""LunarLander with continuous actions as in the thesis's chapter 4: no bonus for legs, two faults, the touchdown.

Importing this registers ``understudy/Lander-v0``; ``export.verification.lander:understudy/Lander-v0`` does both.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import gymnasium
import numpy as np

from task.errors import UserError

ID = f"{__name__}:understudy/Lander-v0"
"""What ``gymnasium.make`` takes, wherever it is called."""

Fault = Literal["none", "noisy_position", "weak_engine"]
FAULTS: tuple[Fault, ...] = get_args(Fault)
"""Nominal, F1 and F2 of the thesis's section 4.4."""

MAX_STEPS = 1000
LEG_BONUS = 10.0
"""LunarLander's reward for each leg on the ground; the thesis leaves it out."""
X, Y, VX, VY, ANGLE, SPIN, LEFT_LEG, RIGHT_LEG = range(8)
"""Indices of the observation (thesis eq. 4.1); lengths in half widths of the screen."""
POSITION_NOISE = 0.05
"""Standard deviation of F1 on x and y; the thesis gives none. The pad reaches from -0.2 to 0.2."""
ENGINE_LIMIT = 0.75
"""Largest effective thrust of F2, of the healthy engine's."""
FUEL_COST = 0.3
"""Reward that full thrust of the main engine costs in a step."""

State = np.ndarray
Step = tuple[np.ndarray, float, bool, bool, dict[str, Any]]


class Lander(gymnasium.Wrapper[State, np.ndarray, State, np.ndarray]):
    """LunarLander without its bonus for legs on the ground; remembers how it touched down."""

    impact: tuple[float, float] = (0.0, 0.0)
    """Behavioural characteristics (thesis eq. 4.2): x and vertical velocity at the first touch of a leg, or the last
    before the end; in the observation's units."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, dict[str, Any]]:
        """Start an episode."""
        s, info = self.env.reset(seed=seed, options=options)
        self._legs, self._touched = 0.0, False
        self.impact = (float(s[X]), float(s[VY]))
        return s, info

    def step(self, action: np.ndarray) -> Step:
        """Advance; action (2,): main and lateral engine in [-1, 1]."""
        s, reward, terminated, truncated, info = self.env.step(action)
        if not self._touched:
            self.impact = (float(s[X]), float(s[VY]))
        legs = float(s[LEFT_LEG] + s[RIGHT_LEG])
        self._touched = self._touched or legs > 0.0
        if not terminated:  # the last reward is the bare verdict, +-100
            reward = float(reward) - LEG_BONUS * (legs - self._legs)
        self._legs = legs
        return s, float(reward), terminated, truncated, info


class NoisyPosition(gymnasium.Wrapper[State, np.ndarray, State, np.ndarray]):
    """F1: zero-mean Gaussian noise on the observed x and y; a function of the episode's seed."""

    _rng: np.random.Generator | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, dict[str, Any]]:
        """Start an episode."""
        s, info = self.env.reset(seed=seed, options=options)
        if seed is not None or self._rng is None:
            self._rng = np.random.default_rng(seed)
        return self._disturb(s), info

    def step(self, action: np.ndarray) -> Step:
        """Advance."""
        s, reward, terminated, truncated, info = self.env.step(action)
        return self._disturb(s), float(reward), terminated, truncated, info

    def _disturb(self, s: State) -> State:
        assert self._rng is not None, "an episode begins with a reset"
        s = s.copy()
        s[[X, Y]] += (POSITION_NOISE * self._rng.standard_normal(2)).astype(s.dtype)
        return s


class WeakEngine(gymnasium.Wrapper[State, np.ndarray, State, np.ndarray]):
    """F2: the main engine gives at most 75 % of its thrust and burns the fuel of what was asked."""

    def step(self, action: np.ndarray) -> Step:
        """Advance."""
        asked = thrust(float(action[0]))
        given = min(asked, ENGINE_LIMIT)
        broken = np.array([2.0 * given - 1.0 if given else -1.0, action[1]], dtype=action.dtype)
        s, reward, terminated, truncated, info = self.env.step(broken)
        if not terminated:
            reward = float(reward) - FUEL_COST * (asked - given)
        return s, float(reward), terminated, truncated, info


def thrust(main: float) -> float:
    """Return the main engine's thrust over its greatest: off up to 0, then from one half to one."""
    return (min(main, 1.0) + 1.0) / 2.0 if main > 0.0 else 0.0


def make_lander(fault: Fault = "none") -> gymnasium.Env[np.ndarray, np.ndarray]:
    """Return one lander, healthy or with a fault; raise UserError for a fault that is not known."""
    if fault not in FAULTS:
        raise UserError(f"lander: no fault '{fault}'; expected one of {', '.join(FAULTS)}")
    env: gymnasium.Env[np.ndarray, np.ndarray] = Lander(
        gymnasium.make("LunarLander-v3", continuous=True, disable_env_checker=True, max_episode_steps=MAX_STEPS)
    )
    if fault == "noisy_position":
        return NoisyPosition(env)
    return WeakEngine(env) if fault == "weak_engine" else env


gymnasium.register(ID.split(":")[1], entry_point=f"{__name__}:make_lander", max_episode_steps=MAX_STEPS)
