"""A small cast that flies, written through the real export."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from export.folder import write_population
from export.network import Layer, Network, flatten
from export.population import Description, Member, Population
from export.prior import Prior
from task.state import ACTION, N_ACTION, N_OBSERVATION, OBSERVATION

TRIM = (-0.0248, 0.0, 0.0)
"""Deflections of the Citation at 2000 m and 90 m/s [rad]."""
PITCH_GAINS = {"lazy": 0.25, "calm": 0.5, "good": 1.0, "strong": 3.0}
"""Members by name: how hard each holds pitch; 1 is well tuned."""


def law(pitch: float) -> np.ndarray:
    """Return gains (3, 7) of a linear law that follows pitch, bank and sideslip."""
    gains = np.zeros((N_ACTION, N_OBSERVATION))
    gains[ACTION.de, OBSERVATION.theta_e], gains[ACTION.de, OBSERVATION.q] = -0.8 * pitch, 0.4 * pitch
    gains[ACTION.da, OBSERVATION.phi_e], gains[ACTION.da, OBSERVATION.p] = -0.6, 0.2
    gains[ACTION.dr, OBSERVATION.beta_e] = 0.3
    return gains


@pytest.fixture(scope="session")
def flying_cast(tmp_path_factory: pytest.TempPathFactory, short_prior: Prior) -> Path:
    """Return an exported population of linear laws; a lazy one flies first, so that there is reason to switch."""
    network = Network(layers=(Layer(units=3, activation="linear"),), action_scale=(1.0, 1.0, 1.0), action_offset=TRIM)
    weights = np.stack([law(gain) for gain in PITCH_GAINS.values()])
    biases = np.zeros((len(PITCH_GAINS), N_ACTION))
    parameters = flatten(network, {"layers.0.weight": weights, "layers.0.bias": biases})
    members = tuple(Member(name=name, scores={}) for name in PITCH_GAINS)
    description = Description(network=network, members=members, champion="lazy", training={"made": "by hand"})
    folder = tmp_path_factory.mktemp("flying") / "laws"
    write_population(Population(description, parameters), short_prior, folder)
    return folder


@pytest.fixture
def damaged_cast(flying_cast: Path, tmp_path: Path) -> Callable[[str, Callable[[bytes], bytes]], Path]:
    """Return a function: a copy of the cast with one file's bytes changed."""

    def damage(file: str, change: Callable[[bytes], bytes]) -> Path:
        copy = tmp_path / "damaged"
        shutil.copytree(flying_cast, copy)
        (copy / file).write_bytes(change((copy / file).read_bytes()))
        return copy

    return damage
