"""Members for other aircraft: the champion with its answers to some observations made stronger or weaker.

A network answers to sideslip, to rates or to the angle of attack as far as training asked it to. Where the aircraft is
weaker, faster or wilder than that, more of one answer or less of another flies it better, and imagination tells which.
Weighting an observation is exact: it is the columns of the first layer's weights.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from export.network import unflatten
from export.population import Population, with_members
from task.state import OBSERVATION

_theta, _phi, _beta = OBSERVATION.theta_e, OBSERVATION.phi_e, OBSERVATION.beta_e
_p, _r, _alpha = OBSERVATION.p, OBSERVATION.r, OBSERVATION.alpha
GAINS: tuple[Mapping[OBSERVATION, float], ...] = (
    {_beta: 8.0, _theta: 2.0, _r: 0.5},
    {_beta: 8.0, _theta: 2.0, _p: 0.5},
    {_beta: 8.0, _theta: 2.0, _phi: 2.0},
    {_beta: 16.0, _r: 0.5},
    {_beta: 16.0, _theta: 2.0, _p: 0.5},
    {_beta: 16.0, _theta: 2.0, _r: 0.5},
    {_beta: 16.0, _theta: 2.0, _phi: 2.0},
    {_beta: 4.0, _phi: 2.0, _r: 0.5},
    {_beta: 0.0, _theta: 2.0, _phi: 2.0},
    {_alpha: 0.5},
)
"""Factors of observations, for SERL(50)'s champion: of some hundred such sets, looked for by what is best of each easy
tuning flight in hindsight, those ten with which the preset ``structured`` flies such flights best and calmest."""


def gain_name(member: str, gains: Mapping[OBSERVATION, float]) -> str:
    """Return the name of a member with other gains: ``actor_48/beta_e*8+r*0.5``."""
    return f"{member}/{'+'.join(f'{each.name}*{factor:g}' for each, factor in gains.items())}"


def with_gains(population: Population, where: str) -> Population:
    """Return the population with its champion at each of ``GAINS`` behind its members.

    Raises UserError, naming ``where``, when the names are taken.
    """
    rows = np.repeat(population.parameters[population.champion, None], len(GAINS), axis=0)
    weights = unflatten(population.network, rows)["layers.0.weight"]
    for weight, gains in zip(weights, GAINS, strict=True):
        for each, factor in gains.items():
            weight[:, each] *= factor
    names = [gain_name(population.description.champion, gains) for gains in GAINS]
    return with_members(population, names, rows, f"{where}: --gains")
