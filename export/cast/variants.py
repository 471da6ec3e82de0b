"""Policies made from a policy: mirrors for reversed surfaces, other gain levels about the same trim."""

from __future__ import annotations

import msgspec
import numpy as np

from export.mirrors import mirror_name
from export.network import Network, flatten, forward, unflatten
from task.state import ACTION, N_ACTION, N_OBSERVATION, OBSERVATION


def symmetric(network: Network) -> np.ndarray:
    """Return which parameters (K,) a policy of one layer may use that treats left and right alike.

    Seen in a mirror, phi, beta, p, r, aileron and rudder change their sign and everything else does not: the elevator
    answers to what does not, aileron and rudder to what does, without a bias.
    """
    o = OBSERVATION
    tensors = {"layers.0.weight": np.zeros((1, N_ACTION, N_OBSERVATION)), "layers.0.bias": np.zeros((1, N_ACTION))}
    weight = tensors["layers.0.weight"][0]
    weight[ACTION.de, [o.theta_e, o.q, o.alpha]] = 1.0
    weight[np.ix_([ACTION.da, ACTION.dr], [o.phi_e, o.beta_e, o.p, o.r])] = 1.0
    tensors["layers.0.bias"][0, ACTION.de] = 1.0
    return flatten(network, tensors)[0] > 0.0


def mirrored(network: Network, parameters: np.ndarray, axes: tuple[ACTION, ...]) -> np.ndarray:
    """Return parameters (K,) that command the opposite on ``axes``; exact for an odd last layer without offset."""
    row = parameters.copy()
    tensors = unflatten(network, row)
    last = f"layers.{len(network.layers) - 1}."
    for kind in ("weight", "bias"):
        tensors[last + kind][list(axes)] *= -1.0
    return row


def levelled(network: Network, parameters: np.ndarray, gain: float, alpha: float) -> np.ndarray:
    """Return parameters (K,) whose last layer reacts ``gain`` times as much, with the same command at trim.

    alpha: angle of attack of the trim [rad], where the errors and rates are zero. The last layer must not be
    normalised.
    """
    open_end = msgspec.structs.replace(
        network,
        layers=(*network.layers[:-1], msgspec.structs.replace(network.layers[-1], activation="linear")),
        action_scale=(1.0,) * N_ACTION,
        action_offset=(0.0,) * N_ACTION,
    )
    s = np.zeros(N_OBSERVATION)
    s[OBSERVATION.alpha] = alpha
    row = parameters.copy()
    tensors = unflatten(network, row)
    trim = forward(open_end, {name: tensor[None] for name, tensor in tensors.items()}, s)[0]
    last = f"layers.{len(network.layers) - 1}."
    weight, bias = tensors[last + "weight"], tensors[last + "bias"]
    bias += (1.0 - gain) * (trim - bias)
    weight *= gain
    return row


def variant_name(member: str, gain: float, axes: tuple[ACTION, ...]) -> str:
    """Return the name of a member's variant: ``nominal*0.4/-ea``."""
    name = member if gain == 1.0 else f"{member}*{gain:g}"
    return mirror_name(name, axes) if axes else name
