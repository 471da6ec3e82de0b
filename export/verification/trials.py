"""Landers on trial: policies flown in the nominal case and with each fault, and the pick of one for a fault."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from export.network import Network
from export.training.config import EnvironmentSettings
from export.training.gymnasium_rollouts import SEEDS, GymnasiumRollouts
from export.verification.lander import FAULTS, ID, Fault
from task.errors import UserError
from task.files import atomic, make_folder

TOGETHER = 100
"""Landers that fly side by side, and are remembered together."""
SOLVED = 200.0
"""Return from which on the thesis calls an episode solved."""


class Cast(NamedTuple):
    """Policies of one shape."""

    network: Network
    parameters: np.ndarray
    """(P, K) float32."""

    def pick(self, members: np.ndarray | list[int]) -> Cast:
        """Return some of them."""
        return Cast(self.network, self.parameters[members])


class Landed(NamedTuple):
    """Of P policies on E episodes."""

    returns: np.ndarray
    """(P, E)."""
    behaviour: np.ndarray
    """(P, E, 2) x and vertical velocity at touchdown (thesis eq. 4.2)."""


class Grounds:
    """Where landers are tried: healthy ones, and ones with each fault.

    What was flown is remembered in a folder, so that a measurement that was stopped goes on where it was.
    """

    def __init__(self, memory: Path) -> None:
        """Make the environments; ``memory`` is the folder, made as needed."""
        self._memory = memory
        make_folder(memory, "--memory")
        self._rollouts = {
            fault: GymnasiumRollouts(EnvironmentSettings(id=ID, arguments={"fault": fault})) for fault in FAULTS
        }
        self.episodes = 0
        """Asked for so far."""
        self.recalled = 0
        """Of them, flown by an earlier start."""

    def land(self, cast: Cast, fault: Fault, tasks: np.ndarray) -> Landed:
        """Fly all policies through the episodes of the seeds ``tasks`` (E,)."""
        step = max(TOGETHER // len(tasks), 1)
        groups = [
            self._remembered(cast.network, cast.parameters[start : start + step], fault, tasks)
            for start in range(0, len(cast.parameters), step)
        ]
        self.episodes += len(cast.parameters) * len(tasks)
        returns, behaviour = zip(*groups, strict=True)
        return Landed(np.concatenate(returns), np.concatenate(behaviour))

    def _remembered(self, network: Network, parameters: np.ndarray, fault: Fault, tasks: np.ndarray) -> Landed:
        """Fly some policies, or recall how they flew."""
        what = hashlib.sha256(msgspec.json.encode(network))
        for part in (parameters.astype(np.float32).tobytes(), fault.encode(), tasks.astype(np.int64).tobytes()):
            what.update(part)
        path = self._memory / f"{what.hexdigest()[:20]}.npz"
        if path.exists():
            try:
                with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                    landed = Landed(file["returns"], file["behaviour"])
            except (OSError, ValueError, AttributeError, KeyError, EOFError, zipfile.BadZipFile):
                raise UserError(f"{path}: holds no flights; delete it, and they are flown again") from None
            self.recalled += landed.returns.size
            return landed
        rollouts = self._rollouts[fault]
        flights = rollouts.fly(network, parameters, tasks)
        landed = Landed(flights.returns(), rollouts.attribute("impact", flights.length.shape))
        with atomic(path) as file:
            np.savez(file, returns=landed.returns, behaviour=landed.behaviour)
        return landed


def seeds(stream: int, count: int) -> np.ndarray:
    """Return ``count`` seeds of episodes of a stream of its own, (count,) int64."""
    return np.random.default_rng(stream).integers(SEEDS, size=count)


def worst_case(returns: np.ndarray) -> float:
    """Return the thesis's worst-case performance: the mean less half a standard deviation (section 4.5)."""
    return float(returns.mean() - returns.std() / 2.0)


class Choice(NamedTuple):
    """A policy picked by trial."""

    member: int
    episodes: int
    """Flown to find it."""


def choose(grounds: Grounds, cast: Cast, fault: Fault, stream: int, first: int, then: int, keep: int) -> Choice:
    """Pick a policy for a fault by trying: all on ``first`` episodes, the best ``keep`` of them on ``then`` more.

    Nobody is told what is broken; the returns of the trials are all that is seen.
    """
    before = grounds.episodes
    tried = grounds.land(cast, fault, seeds(stream, first)).returns.mean(axis=1)
    best = np.argsort(-tried)[:keep]
    again = grounds.land(cast.pick(best), fault, seeds(stream + 1, then)).returns.mean(axis=1)
    return Choice(int(best[again.argmax()]), grounds.episodes - before)
