"""What a population folder says of itself: layouts, scales, hashes, golden samples, provenance."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from export.golden import (
    GoldenActions,
    GoldenImagination,
    GoldenLaws,
    golden_actions,
    golden_imagination,
    golden_laws,
)
from export.network import Network, Tensor, layout
from export.population import Member, Population
from export.prior import COMMAND_LAG, Prior
from export.rollout import MAX_DELAY
from task.config import Settings
from task.limits import DT
from task.model import DYNAMIC, REDUCED_REGRESSORS
from task.state import (
    ACTION,
    ACTION_TABLE,
    N_IDENTIFIED,
    OBSERVATION,
    STATE,
    STATE_TABLE,
)

FORMAT = "understudy-population"
VERSION = 3
MANIFEST = "manifest.json"


class SignalLayout(Settings, frozen=True):
    """One entry of a vector, in its place."""

    symbol: str
    unit: str
    meaning: str


class PriorLayout(Settings, frozen=True):
    """Layout of ``model_prior.npz``: dx[k + 1] of ``outputs`` = theta' z[k], z = increments of ``regressors``."""

    regressors: tuple[str, ...]
    """Rows of theta; an action's increment is that of the command which acts now (command lag)."""
    outputs: tuple[str, ...]
    """Columns of theta."""


class Manifest(Settings, frozen=True):
    """``manifest.json``."""

    format: str
    version: int
    name: str
    dt: float
    """Sample time of the policies and of the model [s]."""
    command_lag: int
    """Samples between a command and the increment that it moves, beyond eq. 8.2."""
    max_delay: int
    """Longest delay beyond ``command_lag`` that the imagination carries [samples]."""
    network: Network
    parameters: tuple[Tensor, ...]
    members: tuple[Member, ...]
    champion: str
    observation: tuple[SignalLayout, ...]
    action: tuple[SignalLayout, ...]
    state: tuple[SignalLayout, ...]
    """The states that the imagination starts from."""
    model_prior: PriorLayout
    files: dict[str, str]
    """SHA-256 of every other file, by its path in the folder."""
    golden_actions: GoldenActions
    golden_imagination: GoldenImagination
    training: dict[str, Any]
    exported_with: dict[str, str]
    """Versions of what wrote this folder."""
    golden_laws: GoldenLaws | None = None
    """None in a folder of before there was a graph of laws."""


def state_layout() -> tuple[SignalLayout, ...]:
    """Return the layout of the identified states."""
    return tuple(SignalLayout(symbol=s.symbol, unit=s.unit, meaning=s.meaning) for s in STATE_TABLE[:N_IDENTIFIED])


def action_layout() -> tuple[SignalLayout, ...]:
    """Return the layout of the action."""
    return tuple(SignalLayout(symbol=s.symbol, unit=s.unit, meaning=s.meaning) for s in ACTION_TABLE)


def observation_layout() -> tuple[SignalLayout, ...]:
    """Return the layout of the observation: tracking errors (``_e``), then states (eq. 11)."""
    states = {s.symbol: s for s in state_layout()}
    rows = []
    for entry in OBSERVATION:
        base = states[entry.name.removesuffix("_e")]
        meaning = base.meaning if base.symbol == entry.name else f"reference minus {base.meaning}"
        rows.append(SignalLayout(symbol=entry.name, unit=base.unit, meaning=meaning))
    return tuple(rows)


def prior_layout() -> PriorLayout:
    """Return the layout of the model prior."""
    symbols = [STATE(i).name for i in range(N_IDENTIFIED)] + [f"d_{a.name}" for a in ACTION]
    return PriorLayout(
        regressors=tuple(symbols[i] for i in REDUCED_REGRESSORS), outputs=tuple(symbols[i] for i in DYNAMIC)
    )


def file_hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file below ``folder`` but the manifest."""
    paths = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != MANIFEST)
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths}


def describe(
    population: Population, prior: Prior, folder: Path, name: str, versions: dict[str, str], lag: int = COMMAND_LAG
) -> Manifest:
    """Return the manifest of a folder whose other files are written."""
    play = golden_imagination(population, prior, lag)
    return Manifest(
        format=FORMAT,
        version=VERSION,
        name=name,
        dt=DT,
        command_lag=lag,
        max_delay=MAX_DELAY,
        network=population.network,
        parameters=layout(population.network),
        members=population.description.members,
        champion=population.description.champion,
        observation=observation_layout(),
        action=action_layout(),
        state=state_layout(),
        model_prior=prior_layout(),
        files=file_hashes(folder),
        golden_actions=golden_actions(population),
        golden_imagination=play,
        training=population.description.training,
        exported_with=versions,
        golden_laws=golden_laws(play, prior),
    )
