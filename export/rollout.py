"""The imagination written plainly in numpy: the reference of the exported graphs and of the golden samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from export.network import Network, forward, unflatten
from task.actuators import HEALTHY, limited
from task.laws import reference_rates, seen, step
from task.limits import ACTION_HIGH, ACTION_LOW
from task.model import predict_increment
from task.observation import observation, tracking_error
from task.reward import CRASH_COST_PER_FRAME, terminated, tracking_reward, unsafe
from task.state import N_IDENTIFIED

MAX_DELAY = 20
"""Longest delay of the commands that is imagined, beyond the command lag [samples]."""

Act = Callable[[int, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Commands (A, 3) [rad] within limits, from the step's number, states and their last increments (A, 10), and the
commands that moved these increments (A, 3) [rad]."""


class Imagined(NamedTuple):
    """What came of A imagined flights."""

    returns: np.ndarray
    """(A,) undiscounted return."""
    unsafe: np.ndarray
    """(A,) samples in which the flight was unsafe (eq. 14) and not yet lost."""
    travel: np.ndarray
    """(A,) how far the commands that acted were moved until the flight was lost [rad], all surfaces together."""


def rollout(
    network: Network,
    parameters: np.ndarray,
    x: np.ndarray,
    dx: np.ndarray,
    commands: np.ndarray,
    delay: int,
    model: np.ndarray,
    exact_kinematics: bool,
    reference: np.ndarray,
    actuators: np.ndarray = HEALTHY,
) -> Imagined:
    """Return what comes of each of P actors in the incremental model; parameters: (P, K) flat, the rest as in `flown`.

    The policy acts on row t of the reference and the state that follows is scored against row t + 1.
    """
    tensors = unflatten(network, parameters.astype(x.dtype))

    def act(t: int, state: np.ndarray, increment: np.ndarray, acted: np.ndarray) -> np.ndarray:
        return forward(network, tensors, observation(state, reference[t])).clip(ACTION_LOW, ACTION_HIGH)

    return flown(act, parameters.shape[0], x, dx, commands, delay, model, exact_kinematics, reference, actuators)


def rollout_laws(
    maps: np.ndarray,
    memory: np.ndarray,
    x: np.ndarray,
    dx: np.ndarray,
    commands: np.ndarray,
    delay: int,
    model: np.ndarray,
    exact_kinematics: bool,
    reference: np.ndarray,
    actuators: np.ndarray = HEALTHY,
) -> Imagined:
    """Return what comes of each of Q laws of :mod:`task.laws` in the incremental model; the rest as in `flown`.

    maps: (Q, 3 + N_MEMORY, N_MEMORY + N_SEEN); memory: (Q, N_MEMORY).
    """
    maps, remembered = maps.astype(x.dtype), memory.astype(x.dtype)
    rates = reference_rates(reference)

    def act(t: int, state: np.ndarray, increment: np.ndarray, acted: np.ndarray) -> np.ndarray:
        nonlocal remembered
        command, remembered = step(maps, remembered, seen(state, increment, acted, reference[t], rates[t]))
        return command

    return flown(act, maps.shape[0], x, dx, commands, delay, model, exact_kinematics, reference, actuators)


def flown(
    act: Act,
    flights: int,
    x: np.ndarray,
    dx: np.ndarray,
    commands: np.ndarray,
    delay: int,
    model: np.ndarray,
    exact_kinematics: bool,
    reference: np.ndarray,
    actuators: np.ndarray = HEALTHY,
) -> Imagined:
    """Return what comes of flights from one start in the incremental model (thesis eqs 8.2, 12, 14).

    x, dx: (10,) state and its last increment; commands: (lag + 1 + MAX_DELAY, 3) the last commands sent [rad], oldest
    first; delay: every command acts so many samples later than the lag says, 0 to MAX_DELAY; model: (13, 10);
    reference: (H + 1, 3) [rad], row t is t samples after x; actuators: (3, 3) of :mod:`task.actuators`, which limit a
    command when its turn comes to act. The last command that acted and the next, where it was sent already, are taken
    to act as given. From the step in which a flight leaves the limits of ``task.reward.terminated`` on, every step
    costs CRASH_COST_PER_FRAME. Computes in x's precision.
    """
    actuators = actuators.astype(x.dtype)
    state, increment = np.tile(x, (flights, 1)), np.tile(dx, (flights, 1))
    sent = np.tile(commands[MAX_DELAY - delay :], (flights, 1, 1))
    given = sent.shape[1] > 1
    alive = np.ones(flights, dtype=bool)
    returns, dangers, travel = np.zeros((3, flights), dtype=x.dtype)
    # A flight that is lost in the model may diverge until nothing is finite: it is no longer looked at.
    with np.errstate(all="ignore"):
        for t, following in enumerate(reference[1:]):
            action = act(t, state, increment, sent[:, 0])
            sent = np.concatenate([sent, action[:, None].astype(x.dtype)], axis=1)
            if t or not given:
                sent[:, 1] = limited(sent[:, 1], sent[:, 0], actuators)
            moved = sent[:, 1] - sent[:, 0]
            increment = predict_increment(state, increment, moved, model, exact_kinematics)
            sent = sent[:, 1:]
            state = state + increment
            alive &= ~terminated(state)
            reward = tracking_reward(tracking_error(state[:, :N_IDENTIFIED], following))
            returns += np.where(alive, reward, -CRASH_COST_PER_FRAME)
            dangers += alive & unsafe(state)
            travel += np.where(alive, np.abs(moved).sum(axis=1), 0.0)
    return Imagined(returns, dangers, travel)
