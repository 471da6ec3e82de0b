"""A trained run as it lies on disk: parameters of every member, network, scores, champion, provenance."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from export.network import Network, Tensor, layout, n_parameters, validate
from task.config import Settings, load_json, read_bytes, to_json
from task.errors import UserError
from task.files import atomic, make_folder

DESCRIPTION = "population.json"
PARAMETERS = "parameters.npy"
TRAINING_RECORDS = ("config.toml", "learning_curve.csv", "learning_curve.png")
"""What a run may hold beside its population; copied as it is."""


class Member(Settings, frozen=True):
    """One actor of the population."""

    name: str
    scores: dict[str, float] = {}
    """Any figures of merit by name; not read in flight."""


class Description(Settings, frozen=True):
    """``population.json`` of a trained run."""

    network: Network
    members: tuple[Member, ...]
    """In the order of the rows of ``parameters.npy``."""
    champion: str
    """Name of the member that flies first."""
    training: dict[str, Any] = {}
    """Provenance: seed, configuration, versions, times; free."""
    parameters: tuple[Tensor, ...] | None = None
    """Parameter layout, checked when it is given."""


class Population(NamedTuple):
    """A population of actors of one shape."""

    description: Description
    parameters: np.ndarray
    """(P, K) float32."""

    @property
    def network(self) -> Network:
        """Return the network that all members share."""
        return self.description.network

    @property
    def champion(self) -> int:
        """Return the champion's row."""
        return [m.name for m in self.description.members].index(self.description.champion)


def with_members(population: Population, names: Sequence[str], parameters: np.ndarray, where: str) -> Population:
    """Return the population with more members, parameters (N, K), behind its own.

    Raises UserError, naming ``where``, when a name is taken.
    """
    description = population.description
    if taken := sorted({m.name for m in description.members} & set(names)):
        raise UserError(f"{where}: the population has members {', '.join(taken)} already")
    members = (*description.members, *(Member(name=name) for name in names))
    return Population(
        msgspec.structs.replace(description, members=members), np.concatenate([population.parameters, parameters])
    )


def load_array(path: Path, what: str) -> np.ndarray:
    """Return a ``.npy`` file's array; raise UserError when it is missing, corrupted or pickled."""
    try:
        return np.load(io.BytesIO(read_bytes(path, what)), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise UserError(f"{path}: not a plain .npy array: {str(error).splitlines()[0]}") from None


def checked(population: Population, where: str) -> Population:
    """Return the population; raise UserError, naming ``where``, when its parts do not fit together."""
    description, parameters = population
    validate(description.network, where)
    expected_layout = layout(description.network)
    if description.parameters is not None and description.parameters != expected_layout:
        raise UserError(
            f"{where}: parameters: expected the layout of the network ({', '.join(t.name for t in expected_layout)} "
            f"without gaps), got {', '.join(t.name for t in description.parameters)}"
        )
    names = [m.name for m in description.members]
    if not names or len(set(names)) != len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise UserError(f"{where}: members: expected at least one and unique names, got {twice or names}")
    if wrong := [name for name in names if name != name.strip() or not (name and name.isprintable())]:
        raise UserError(f"{where}: members: expected names in one line of printable text, got {wrong[0]!r}; rename it")
    if description.champion not in names:
        raise UserError(f"{where}: champion: expected a member's name, got {description.champion!r}")
    shape = (len(names), n_parameters(description.network))
    if parameters.dtype != np.float32 or parameters.shape != shape:
        raise UserError(
            f"{where}: {PARAMETERS}: expected float32 {shape} (members, parameters), "
            f"got {parameters.dtype} {parameters.shape}"
        )
    if not np.isfinite(parameters).all():
        bad = names[int(np.argmin(np.isfinite(parameters).all(axis=1)))]
        raise UserError(f"{where}: {PARAMETERS}: parameters of member {bad!r} are not finite; train it again")
    return population


def load_run(folder: Path) -> Population:
    """Read a trained run; raise UserError when something is missing, malformed or does not fit."""
    if not folder.is_dir():
        raise UserError(f"{folder}: no such trained run; train one with 'understudy train'")
    description = load_json(folder / DESCRIPTION, Description, "description of a trained population")
    return checked(
        Population(description, load_array(folder / PARAMETERS, "parameters of a trained population")), str(folder)
    )


def save_run(population: Population, folder: Path) -> None:
    """Write a population as a trained run, so that any stacked MLP actors can be exported."""
    checked(population, str(folder))
    write_run(population, folder)


def write_run(population: Population, folder: Path) -> None:
    """Write parameters, then the description: a write that is cut short leaves a folder that is not taken for a run."""
    make_folder(folder)
    (folder / DESCRIPTION).unlink(missing_ok=True)
    with atomic(folder / PARAMETERS) as file:
        np.save(file, population.parameters, allow_pickle=False)
    with atomic(folder / DESCRIPTION) as file:
        file.write(to_json(population.description))
