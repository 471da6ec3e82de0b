"""Members for surfaces that work backwards: the champion with the sign of one, two or three of its commands turned.

A command is absolute deflection, so that a reversed surface told the opposite does what was meant, trim included. The
mirror is exact: the last layer is odd (tanh or linear, no offset), and negating one of its rows negates that command.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from export.network import unflatten
from export.population import Population, with_members
from task.errors import UserError
from task.state import ACTION, N_ACTION

LETTERS = {ACTION.de: "e", ACTION.da: "a", ACTION.dr: "r"}
ODD = ("tanh", "linear")
"""Activations f with f(-x) = -f(x)."""
AXES = tuple(axes for n in range(1, N_ACTION + 1) for axes in combinations(ACTION, n))
"""Every set of surfaces that may be reversed, the small ones first."""


def mirror_name(member: str, axes: tuple[ACTION, ...]) -> str:
    """Return the name of a member's mirror: ``member/-ea`` turns elevator and aileron."""
    return f"{member}/-{''.join(LETTERS[a] for a in axes)}"


def with_mirrors(population: Population, where: str) -> Population:
    """Return the population with the seven mirrors of its champion behind its members.

    Raises UserError, naming ``where``, when the network's mirror would not be exact or the names are taken.
    """
    description, network = population.description, population.description.network
    last = network.layers[-1].activation
    if last not in ODD or any(network.action_offset):
        raise UserError(
            f"{where}: --mirrors: expected a last layer of {' or '.join(ODD)} and action_offset 0, "
            f"got {last} and {network.action_offset}; export without --mirrors"
        )
    rows = np.repeat(population.parameters[population.champion, None], len(AXES), axis=0)
    tensors = unflatten(network, rows)
    final = f"layers.{len(network.layers) - 1}."
    # A normalised layer's sign is in its gain and shift, another's in its weight and bias.
    kinds = ("weight", "bias") if network.layers[-1].layer_norm == "none" else ("gain", "shift")
    for mirror, axes in enumerate(AXES):
        for kind in kinds:
            tensors[final + kind][mirror, list(axes)] *= -1.0
    names = [mirror_name(description.champion, axes) for axes in AXES]
    return with_members(population, names, rows, f"{where}: --mirrors")
