"""The imagination written plainly in numpy: the reference of the exported graph and of the golden samples."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from export.network import Network, forward, unflatten
from task.limits import ACTION_HIGH, ACTION_LOW
from task.model import predict_increment
from task.observation import observation, tracking_error
from task.reward import CRASH_COST_PER_FRAME, terminated, tracking_reward, unsafe
from task.state import N_IDENTIFIED

MAX_DELAY = 20
"""Longest delay of the commands that is imagined, beyond the command lag [samples]."""


class Imagined(NamedTuple):
    """What came of P imagined flights."""

    returns: np.ndarray
    """(P,) undiscounted return."""
    unsafe: np.ndarray
    """(P,) samples in which the flight was unsafe (eq. 14) and not yet lost."""


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
) -> Imagined:
    """Return what comes of each of P actors in the incremental model (thesis eqs 8.2, 12, 14).

    parameters: (P, K) flat; x, dx: (10,) state and its last increment; commands: (lag + 1 + MAX_DELAY, 3) the last
    commands sent [rad], oldest first; delay: every command acts so many samples later than the lag says, 0 to
    MAX_DELAY; model: (13, 10); reference: (H + 1, 3) [rad], row t is t samples after x. The policy acts on row t and
    the state that follows is scored against row t + 1. From the step in which a flight leaves the limits of
    ``task.reward.terminated`` on, every step costs CRASH_COST_PER_FRAME. Computes in x's precision.
    """
    members = parameters.shape[0]
    tensors = unflatten(network, parameters.astype(x.dtype))
    state, increment = np.tile(x, (members, 1)), np.tile(dx, (members, 1))
    sent = np.tile(commands[MAX_DELAY - delay :], (members, 1, 1))
    alive = np.ones(members, dtype=bool)
    returns, dangers = np.zeros(members, dtype=x.dtype), np.zeros(members, dtype=x.dtype)
    # A flight that is lost in the model may diverge until nothing is finite: it is no longer looked at.
    with np.errstate(all="ignore"):
        for now, following in itertools.pairwise(reference):
            action = forward(network, tensors, observation(state, now)).clip(ACTION_LOW, ACTION_HIGH)
            sent = np.concatenate([sent, action[:, None].astype(x.dtype)], axis=1)
            increment = predict_increment(state, increment, sent[:, 1] - sent[:, 0], model, exact_kinematics)
            sent = sent[:, 1:]
            state = state + increment
            alive &= ~terminated(state)
            reward = tracking_reward(tracking_error(state[:, :N_IDENTIFIED], following))
            returns += np.where(alive, reward, -CRASH_COST_PER_FRAME)
            dangers += alive & unsafe(state)
    return Imagined(returns, dangers)
