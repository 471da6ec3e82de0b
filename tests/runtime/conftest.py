"""A cast of linear laws that flies, exported for real, and the plant as an in-process link."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from export.folder import write_population
from export.network import Layer, Network, flatten
from export.population import Description, Member, Population
from export.prior import Prior
from runtime.link import LOST, OVER, Sample
from sim_bridge.plant import Plant
from task.limits import DT
from task.reference import base_reference
from task.reward import terminated
from task.state import ACTION, N_ACTION, N_OBSERVATION, OBSERVATION, STATE

TRIM = (-0.02477, 0.0, 0.0)
"""Deflections of the Citation at 2000 m and 90 m/s [rad]."""


@pytest.fixture
def without_collections() -> Iterator[None]:
    """Keep the collector still while memory is counted: a full collection empties the interpreter's free lists.

    What refills them is then counted as grown, 5 kB in a thousand calls that leave nothing behind.
    """
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def linear_law(pitch: float, roll: float) -> np.ndarray:
    """Return the gains (3, 7) of a law that tracks pitch, bank and sideslip; 1 is well tuned."""
    gains = np.zeros((N_ACTION, N_OBSERVATION))
    gains[ACTION.de, OBSERVATION.theta_e], gains[ACTION.de, OBSERVATION.q] = -0.8 * pitch, 0.4 * pitch
    gains[ACTION.da, OBSERVATION.phi_e], gains[ACTION.da, OBSERVATION.p] = -0.6 * roll, 0.2 * roll
    gains[ACTION.dr, OBSERVATION.beta_e] = 0.3
    return gains


LAWS = {
    "good": linear_law(1.0, 1.0),
    "lazy": linear_law(0.25, 0.4),
    "strong": linear_law(3.0, 1.0),
    "mirror": linear_law(-1.0, 1.0),
}


@pytest.fixture(scope="session")
def cast_folder(tmp_path_factory: pytest.TempPathFactory, short_prior: Prior) -> Path:
    """Return an exported population of linear laws; ``good`` is the champion."""
    network = Network(layers=(Layer(units=3, activation="linear"),), action_scale=(1.0, 1.0, 1.0), action_offset=TRIM)
    weights = np.stack(list(LAWS.values()))
    parameters = flatten(network, {"layers.0.weight": weights, "layers.0.bias": np.zeros((len(LAWS), 3))})
    members = tuple(Member(name=name, scores={}) for name in LAWS)
    description = Description(network=network, members=members, champion="good", training={"made": "by hand"})
    folder = tmp_path_factory.mktemp("casts") / "laws"
    write_population(Population(description, parameters), short_prior, folder)
    return folder


@pytest.fixture(scope="session")
def reference_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the thesis's base case over 20 s as a CSV file."""
    rows = base_reference(20.0, 0.056)
    file = tmp_path_factory.mktemp("references") / "base.csv"
    table = np.column_stack([np.arange(len(rows)) * DT, rows])
    np.savetxt(file, table, delimiter=",", header="t,theta,phi,beta", comments="", fmt="%.9g")
    return file


class PlantLink:
    """The plant as a link, in lockstep: no sockets. ``distort`` changes what is flown or what is seen."""

    def __init__(
        self,
        ticks: int,
        command: Callable[[int, np.ndarray], np.ndarray] = lambda tick, action: action,
        state: Callable[[int, np.ndarray], np.ndarray] = lambda tick, x: x,
    ) -> None:
        self.ended = ""
        self.skipped = self.repeated = 0
        self.plant = Plant()
        self.ticks, self.command, self.state = ticks, command, state
        self.tick = 0
        self.x, self.sent, self.lines = [self.plant.x.copy()], [], []
        self.told_at: list[int] = []
        """The tick of each line."""

    def read(self, timeout: float) -> Sample | None:
        if self.tick >= self.ticks:
            self.ended = OVER
        elif terminated(self.plant.x):
            self.ended = LOST
        if self.ended:
            return None
        return Sample(self.tick * 10_000, 1, self.state(self.tick, self.plant.x.copy()))

    def write(self, action: np.ndarray, time_usec: int) -> None:
        assert time_usec == self.tick * 10_000
        self.sent.append(action.copy())
        self.plant.step(self.command(self.tick, np.asarray(action, dtype=float)))
        self.x.append(self.plant.x.copy())
        self.tick += 1

    def say(self, text: str, severity: int) -> None:
        self.lines.append(text)
        self.told_at.append(self.tick)

    def diagnosis(self) -> str:
        return "a plant"

    def close(self) -> None:
        pass

    def error(self, reference: np.ndarray) -> np.ndarray:
        """Return the mean absolute tracking error of theta and phi [rad], shape (2,)."""
        x = np.array(self.x[: len(reference)])
        return np.abs(x[:, [STATE.theta, STATE.phi]] - reference[: len(x), :2]).mean(axis=0)


@pytest.fixture
def plant_link() -> type[PlantLink]:
    """Return :class:`PlantLink`."""
    return PlantLink
