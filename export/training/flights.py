"""Many flights at once: every actor on every reference, one batched forward pass per tick."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from export.network import Network
from export.training.acting import Cast
from sim_bridge.conditions import NOMINAL, FlightCondition
from sim_bridge.plant import Plant
from task.limits import DT
from task.metrics import smoothness
from task.observation import observation
from task.reference import Family, FamilyName, cosine_steps, n_samples, random_reference
from task.reward import crash_penalty, terminated, tracking_reward, unsafe
from task.state import N_ACTION, N_OBSERVATION, N_REFERENCE, N_STATE, REFERENCE, STATE


class Flights(NamedTuple):
    """What P actors lived through on E references of T samples; nothing after ``length`` means anything."""

    observation: np.ndarray
    """(T + 1, P, E, 7) float32 s[0..T], in SI units."""
    u: np.ndarray
    """(T, P, E, 3) float32 actions in units of their bound."""
    reward: np.ndarray
    """(T, P, E) float32; reward[k] is paid for s[k + 1], with the crash penalty (eq. 13) in a lost flight's last."""
    unsafe: np.ndarray
    """(T, P, E) bool: s[k + 1] is beyond the bounds of eq. 14."""
    length: np.ndarray
    """(P, E) samples flown."""
    lost: np.ndarray
    """(P, E) bool: the flight ended before its time."""

    def flown(self) -> np.ndarray:
        """Return (T, P, E) bool: the samples that were flown."""
        return np.arange(self.u.shape[0])[:, None, None] < self.length

    def returns(self) -> np.ndarray:
        """Return the undiscounted return of each flight (eq. 4), shape (P, E)."""
        return np.where(self.flown(), self.reward, 0.0).sum(axis=0, dtype=float)

    def smoothness(self, action_scale: np.ndarray) -> np.ndarray:
        """Return Sm of each flight (eq. 16) [rad Hz], shape (P, E); action_scale (3,) [rad]."""
        result = np.empty(self.length.shape)
        for i, n in np.ndenumerate(self.length):
            result[i] = smoothness(self.u[(slice(n), *i)] * action_scale)
        return result


def together(groups: list[Flights]) -> Flights:
    """Return flights of several groups of actors on the same references as if they had been flown as one."""
    axes = (1, 1, 1, 1, 0, 0)  # the axis of the actors in each field
    fields = zip(*groups, strict=True)
    return Flights(*(np.concatenate(parts, axis=axis) for axis, parts in zip(axes, fields, strict=True)))


PUBLISHED = Family(np.deg2rad(30.0), np.deg2rad(20.0), 5, 1 / 6, 10)
"""The training references of the published runs; the text has 25 and 45 deg (``task.reference``)."""


def draw_references(
    rng: np.random.Generator, count: int, duration: float, theta_trim: float, family: FamilyName | Literal["published"]
) -> np.ndarray:
    """Draw references (count, T + 1, 3) [rad]; the last sample is held, for the state that follows it."""
    if family == "published":
        drawn = np.stack([_published_reference(rng, duration, theta_trim) for _ in range(count)])
    else:
        drawn = np.stack([random_reference(rng, duration, theta_trim, family) for _ in range(count)])
    return np.concatenate([drawn, drawn[:, -1:]], axis=1)


def _published_reference(rng: np.random.Generator, duration: float, theta_trim: float) -> np.ndarray:
    """Draw one reference (T, 3) [rad] of the family PUBLISHED."""
    reference = np.zeros((n_samples(duration), N_REFERENCE))
    for channel, amplitude in ((REFERENCE.theta, PUBLISHED.theta), (REFERENCE.phi, PUBLISHED.phi)):
        levels = rng.choice(np.linspace(-amplitude, amplitude, PUBLISHED.levels or 2), PUBLISHED.blocks + 1)
        reference[:, channel] = cosine_steps(levels, duration, duration * PUBLISHED.smoothing)
    reference[:, REFERENCE.theta] += theta_trim
    return reference


IN_STEP = 14
"""Aircraft that fly side by side at once: more of them fall out of a core's cache, and fly half as fast."""


class Fleet:
    """Aircraft that fly side by side in one thread; made once, used for every generation."""

    apart = False
    """Whether every flight has an aircraft of its own, in the order of actors and references, to be asked afterwards;
    otherwise one group of actors after the other flies the same few."""

    def __init__(self, condition: FlightCondition = NOMINAL) -> None:
        """Start with one aircraft; others are added as flights ask for them."""
        self.condition = condition
        self.plants = [Plant()]
        self.plants[0].reset(condition)
        self.theta_trim = float(self.plants[0].trim.x[STATE.theta])

    def fly(
        self,
        network: Network,
        parameters: np.ndarray,
        references: np.ndarray,
        noise: np.ndarray | None = None,
        prepare: Callable[[Plant], None] | None = None,
    ) -> Flights:
        """Fly P actors (P, K) on E references (E, T + 1, 3) [rad] from trim, every flight of its own.

        noise: (T, E, 3) added to the last actor's u, which is clipped to [-1, 1]; prepare: called on every
        aircraft after its reset, to break it.
        """
        size = max(IN_STEP // references.shape[0], 1)
        starts = range(0, parameters.shape[0], size)
        groups = [
            self._in_step(network, parameters[i : i + size], references, noise if i == starts[-1] else None, prepare, i)
            for i in starts
        ]
        return together(groups)

    def _in_step(
        self,
        network: Network,
        parameters: np.ndarray,
        references: np.ndarray,
        noise: np.ndarray | None,
        prepare: Callable[[Plant], None] | None,
        first: int,
    ) -> Flights:
        """Fly some of the actors, the first of them number ``first`` of all, P * E aircraft in step."""
        P, E, T = parameters.shape[0], references.shape[0], references.shape[1] - 1
        N = P * E
        begin = first * E if self.apart else 0
        self.plants += [Plant() for _ in range(begin + N - len(self.plants))]
        plants = self.plants[begin : begin + N]
        steps = [plant.step for plant in plants]
        x = np.stack([plant.reset(self.condition) for plant in plants])
        if prepare is not None:
            for plant in plants:
                prepare(plant)
        cast = Cast(network, np.ascontiguousarray(parameters, dtype=np.float32), E)
        scale, offset = np.array(network.action_scale), np.array(network.action_offset)
        wanted = np.tile(references.transpose(1, 0, 2), (1, P, 1))  # (T + 1, N, 3): actor by actor

        states = np.empty((T + 1, N, N_STATE), dtype=np.float32)
        s = np.zeros((T + 1, P, E, N_OBSERVATION), dtype=np.float32)
        u = np.zeros((T, P, E, N_ACTION), dtype=np.float32)
        length = np.full(N, T)
        lost = np.zeros(N, dtype=bool)
        flying = list(range(N))
        states[0] = x
        observation(x, wanted[0], out=s[0].reshape(N, N_OBSERVATION))
        for k in range(T):
            u[k] = cast(s[k])
            if noise is not None:
                np.clip(u[k, -1] + noise[k], -1.0, 1.0, out=u[k, -1])
            a = offset + scale * u[k].reshape(N, N_ACTION)
            for i in flying:
                x[i] = steps[i](a[i])
            newly = terminated(x) & ~lost
            if newly.any():  # what is lost stands still from here on
                lost |= newly
                length[newly] = k + 1
                flying = np.flatnonzero(~lost).tolist()
                broken = ~np.isfinite(x).all(axis=1)
                x[broken] = states[k, broken]
            states[k + 1] = x
            observation(x, wanted[k + 1], out=s[k + 1].reshape(N, N_OBSERVATION))
            if not flying:
                break

        shape = (P, E)
        last = int(length.max())
        reward = np.zeros((T, P, E), dtype=np.float32)
        reward[:last] = tracking_reward(s[1 : last + 1, ..., :N_REFERENCE])
        for p, e in np.argwhere(lost.reshape(shape)):
            n = length.reshape(shape)[p, e]
            reward[n - 1, p, e] += crash_penalty((T - n) * DT)
        danger = np.zeros((T, P, E), dtype=bool)
        danger[:last] = unsafe(states[1 : last + 1].reshape(last, P, E, N_STATE))
        return Flights(s, u, reward, danger, length.reshape(shape), lost.reshape(shape))
