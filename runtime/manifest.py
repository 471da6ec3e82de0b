"""What a population folder says of itself, as the runtime reads it (docs/architecture.md, "A population folder").

Written by somebody else's code on purpose: the folder is the interface, and the contract test holds the two together.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import msgspec

from task.config import Settings
from task.errors import UserError
from task.limits import DT
from task.model import DYNAMIC, REDUCED_REGRESSORS
from task.state import ACTION, ACTION_TABLE, N_ACTION, N_IDENTIFIED, N_OBSERVATION, OBSERVATION, STATE, STATE_TABLE

FORMAT = "understudy-population"
VERSION = 3


class Header(msgspec.Struct):
    """What every version of the manifest begins with."""

    format: str
    version: int


class Layer(Settings, frozen=True):
    """One layer of the network."""

    units: int
    layer_norm: Literal["none", "standard", "unbiased"]
    activation: Literal["tanh", "relu", "leaky_relu", "linear"]


class Network(Settings, frozen=True):
    """The network that all members share; its arithmetic is in the graphs."""

    layers: tuple[Layer, ...]
    observation: int
    action: int
    input_scale: tuple[float, ...]
    layer_norm_eps: float
    leaky_slope: float
    action_scale: tuple[float, ...]
    action_offset: tuple[float, ...]


class Tensor(Settings, frozen=True):
    """Where one parameter tensor lies in a member's flat parameters."""

    name: str
    shape: tuple[int, ...]
    offset: int

    @property
    def size(self) -> int:
        """Number of parameters."""
        return math.prod(self.shape)


class Member(Settings, frozen=True):
    """One member of the cast."""

    name: str
    scores: dict[str, float]


class SignalLayout(Settings, frozen=True):
    """One entry of a vector, in its place."""

    symbol: str
    unit: str
    meaning: str


class PriorLayout(Settings, frozen=True):
    """Rows and columns of the model prior."""

    regressors: tuple[str, ...]
    outputs: tuple[str, ...]


class GoldenActions(Settings, frozen=True):
    """Observations (n, 7) and every member's answer (P, n, 3) [rad], within ``tolerance``."""

    observations: list[list[float]]
    actions: list[list[list[float]]]
    tolerance: float


class GoldenImagination(Settings, frozen=True):
    """One imagination in the model prior with exact kinematics: inputs and returns (P + 1,), within ``tolerance``.

    ``returns`` of healthy actuators, ``limited_returns`` of ``actuators`` (3, 3).
    """

    x: list[float]
    dx: list[float]
    commands: list[list[float]]
    delay: int
    reference: list[list[float]]
    actuators: list[list[float]]
    incumbent: int
    returns: list[float]
    limited_returns: list[float]
    tolerance: float


class GoldenLaws(Settings, frozen=True):
    """Laws of :mod:`task.laws` in the golden imagination's question, and their returns (Q,), within ``tolerance``."""

    maps: list[list[list[float]]]
    memory: list[list[float]]
    returns: list[float]
    limited_returns: list[float]
    tolerance: float


class Manifest(Settings, frozen=True):
    """``manifest.json``."""

    format: str
    version: int
    name: str
    dt: float
    command_lag: int
    max_delay: int
    network: Network
    parameters: tuple[Tensor, ...]
    members: tuple[Member, ...]
    champion: str
    observation: tuple[SignalLayout, ...]
    action: tuple[SignalLayout, ...]
    state: tuple[SignalLayout, ...]
    model_prior: PriorLayout
    files: dict[str, str]
    golden_actions: GoldenActions
    golden_imagination: GoldenImagination
    training: dict[str, Any]
    exported_with: dict[str, str]
    golden_laws: GoldenLaws | None = None
    """None: the folder holds no graph of laws, and no law can be admitted to this cast."""

    @property
    def n_parameters(self) -> int:
        """Return K, the number of parameters of one member."""
        return sum(t.size for t in self.parameters)


def check_header(header: Header, where: str) -> None:
    """Raise UserError unless this runtime reads that manifest."""
    if header.format != FORMAT:
        raise UserError(f"{where}: format: expected {FORMAT!r}, got {header.format!r}; this is not a population")
    if header.version != VERSION:
        raise UserError(f"{where}: version: this runtime reads {VERSION}, got {header.version}; export it again")


def check(manifest: Manifest, where: str) -> None:
    """Raise UserError unless the population sees, commands and predicts what the runtime gives, takes and has."""

    def expect(what: str, got: object, expected: object) -> None:
        if got != expected:
            raise UserError(f"{where}: {what}: expected {expected}, got {got}; export it for this version")

    states = {s.symbol: s.unit for s in STATE_TABLE}
    observation = [(o.name, states[o.name.removesuffix("_e")]) for o in OBSERVATION]
    regressors = [STATE(i).name for i in range(N_IDENTIFIED)] + [f"d_{a.name}" for a in ACTION]
    expect("observation", _pairs(manifest.observation), observation)
    expect("action", _pairs(manifest.action), [(s.symbol, s.unit) for s in ACTION_TABLE])
    expect("state", _pairs(manifest.state), [(s.symbol, s.unit) for s in STATE_TABLE[:N_IDENTIFIED]])
    expect("network.observation", manifest.network.observation, N_OBSERVATION)
    expect("network.action", manifest.network.action, N_ACTION)
    expect("model_prior.regressors", list(manifest.model_prior.regressors), [regressors[i] for i in REDUCED_REGRESSORS])
    expect("model_prior.outputs", list(manifest.model_prior.outputs), [STATE(i).name for i in DYNAMIC])
    expect("dt", manifest.dt, DT)
    if manifest.command_lag < 0:
        raise UserError(f"{where}: command_lag: expected 0 or more samples, got {manifest.command_lag}")
    if manifest.max_delay < 0:
        raise UserError(f"{where}: max_delay: expected 0 or more samples, got {manifest.max_delay}")
    offset = 0
    for tensor in manifest.parameters:
        expect(f"parameters: {tensor.name}: offset", tensor.offset, offset)
        offset += tensor.size
    names = [m.name for m in manifest.members]
    if wrong := [name for name in names if not name or names.count(name) > 1]:
        raise UserError(f"{where}: members: expected each a name of its own, got {wrong[0]!r}; export it again")
    if manifest.champion not in names:
        raise UserError(f"{where}: champion: expected one of the {len(names)} members, got {manifest.champion!r}")
    if not 0 <= (incumbent := manifest.golden_imagination.incumbent) < len(names):
        raise UserError(
            f"{where}: golden_imagination.incumbent: expected a member's number below {len(names)}, got {incumbent}; "
            "export it again"
        )


def _pairs(layout: tuple[SignalLayout, ...]) -> list[tuple[str, str]]:
    return [(s.symbol, s.unit) for s in layout]
