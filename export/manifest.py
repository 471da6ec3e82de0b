"""What a population folder says of itself: layouts, scales, hashes, golden samples, provenance."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from export.network import Network, Tensor, forward, layout, unflatten
from export.population import Member, Population
from export.prior import COMMAND_LAG, Prior
from export.rollout import MAX_DELAY, rollout
from task.config import Settings
from task.limits import DT
from task.model import DYNAMIC, REDUCED_REGRESSORS, embed_reduced
from task.reference import cosine_steps
from task.state import (
    ACTION,
    ACTION_TABLE,
    N_ACTION,
    N_IDENTIFIED,
    N_OBSERVATION,
    N_REFERENCE,
    OBSERVATION,
    REFERENCE,
    STATE,
    STATE_TABLE,
)

FORMAT = "understudy-population"
VERSION = 2
MANIFEST = "manifest.json"

GOLDEN_OBSERVATIONS = 4
GOLDEN_STEPS = 50
GOLDEN_DELAY = 3


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


class GoldenActions(Settings, frozen=True):
    """What each member must answer; computed in float64 from the float32 parameters."""

    observations: list[list[float]]
    """(n, 7)."""
    actions: list[list[list[float]]]
    """(P, n, 3) [rad]."""
    tolerance: float
    """Largest absolute difference that float32 explains [rad]."""


class GoldenImagination(Settings, frozen=True):
    """One small imagination; computed in float64 from the model prior embedded in (13, 10), kinematics exact."""

    x: list[float]
    dx: list[float]
    commands: list[list[float]]
    delay: int
    """Of the commands, beyond ``command_lag`` [samples]."""
    reference: list[list[float]]
    incumbent: int
    """The member whose parameters are the incumbent's."""
    returns: list[float]
    """(P + 1,)."""
    tolerance: float
    """Largest absolute difference that float32 explains."""


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


def golden_actions(population: Population, seed: int = 0) -> GoldenActions:
    """Return observations of the size that flights bring, and every member's answer."""
    rng = np.random.default_rng(seed)
    size = np.full(N_OBSERVATION, 0.2)
    observations = rng.uniform(-size, size, (GOLDEN_OBSERVATIONS, N_OBSERVATION)).astype(np.float32).astype(float)
    tensors = unflatten(population.network, population.parameters.astype(float))
    actions = np.stack([forward(population.network, tensors, s) for s in observations], axis=1)
    return GoldenActions(observations=observations.tolist(), actions=actions.tolist(), tolerance=2e-5)


def golden_imagination(population: Population, prior: Prior, lag: int = COMMAND_LAG) -> GoldenImagination:
    """Return a disturbed start, a gentle reference and every member's return in the prior model."""
    start = np.zeros(N_IDENTIFIED)
    start[[STATE.p, STATE.q, STATE.r]] = 0.02, -0.01, 0.01
    start[[STATE.V, STATE.h]] = 90.0, 2000.0
    start[[STATE.alpha, STATE.beta, STATE.phi, STATE.theta, STATE.psi]] = 0.06, 0.01, 0.1, 0.05, 0.3
    x = start.astype(np.float32).astype(float)
    dx = np.float32(1e-4 * np.sin(np.arange(N_IDENTIFIED))).astype(float)
    sent = N_ACTION * (lag + 1 + MAX_DELAY)
    commands = np.float32(np.linspace(-0.02, 0.01, sent).reshape(-1, N_ACTION)).astype(float)
    steps = np.zeros((GOLDEN_STEPS + 1, N_REFERENCE))
    duration = (GOLDEN_STEPS + 1) * DT
    steps[:, REFERENCE.theta] = cosine_steps(np.array([0.1, 0.0]), duration, duration)
    steps[:, REFERENCE.phi] = cosine_steps(np.array([-0.1, 0.0]), duration, duration)
    reference = steps.astype(np.float32).astype(float)
    model = embed_reduced(prior.theta.astype(np.float32).astype(float))
    parameters = np.concatenate([population.parameters, population.parameters[population.champion, None]])
    imagined = rollout(population.network, parameters, x, dx, commands, GOLDEN_DELAY, model, True, reference)
    return GoldenImagination(
        x=x.tolist(),
        dx=dx.tolist(),
        commands=commands.tolist(),
        delay=GOLDEN_DELAY,
        reference=reference.tolist(),
        incumbent=population.champion,
        returns=imagined.returns.tolist(),
        tolerance=1e-3,
    )


def file_hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file below ``folder`` but the manifest."""
    paths = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != MANIFEST)
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths}


def describe(
    population: Population, prior: Prior, folder: Path, name: str, versions: dict[str, str], lag: int = COMMAND_LAG
) -> Manifest:
    """Return the manifest of a folder whose other files are written."""
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
        golden_imagination=golden_imagination(population, prior, lag),
        training=population.description.training,
        exported_with=versions,
    )
