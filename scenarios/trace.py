"""What a flight leaves behind, as arrays: the aircraft's truth and the runtime's decisions."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import msgspec
import numpy as np
from pyulog import ULog

from task.errors import UserError
from task.state import ACTION, STATE


@dataclass(frozen=True)
class FlightTrace:
    """The true flight at 100 Hz; T samples may be fewer than planned when the aircraft was lost."""

    time: np.ndarray
    """(T,) simulated time [s]."""
    x: np.ndarray
    """(T, 12) true state in the order of ``task.state.STATE``."""
    reference: np.ndarray
    """(T, 3) theta, phi, beta [rad]."""
    command: np.ndarray
    """(T, 3) commanded deflections [rad]."""
    surfaces: np.ndarray
    """(T, 3) true deflections [rad]."""
    faulty: np.ndarray
    """(T,) bool: whether any fault acts."""
    planned_samples: int
    """How many samples the flight was to have."""
    onsets: tuple[float, ...] = ()
    """When each fault begins [s], also while others act."""

    @property
    def fault_at(self) -> float | None:
        """When the first fault begins [s]: None without one, 0 when it is there from the start."""
        acting = np.flatnonzero(self.faulty)
        return float(self.time[acting[0]]) if acting.size else None

    def fault_spans(self) -> list[tuple[float, float]]:
        """Return from when to when [s] anything is broken."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.faulty, [False]]).astype(int)))
        return [(float(self.time[a]), float(self.time[b - 1])) for a, b in edges.reshape(-1, 2)]

    def fault_onsets(self) -> list[float]:
        """Return the times [s] at which a fault begins, in order; where they are not recorded, when anything breaks."""
        return sorted(set(self.onsets)) or [start for start, _ in self.fault_spans()]


class Play(NamedTuple):
    """One imagined comparison of the cast: what each member would earn."""

    time: float
    """When the answer decided [s]."""
    returns: np.ndarray
    """(P + 1,) predicted returns, the incumbent last."""


class Switch(NamedTuple):
    """A change of the cast."""

    time: float
    """[s]"""
    member: int
    """Index of the member that takes over."""


@dataclass(frozen=True)
class AdaptationTrace:
    """What the runtime thought and decided, cycle by cycle."""

    time: np.ndarray
    """(T,) simulated time of each cycle [s]."""
    active: np.ndarray
    """(T,) index of the member that flies, or that a soft switch moves towards."""
    innovation: np.ndarray
    """(T, S) what the model did not foresee of each state's increment (eq. 8.7), SI units per sample."""
    members: list[str]
    """(P,) names of the cast."""
    innovation_names: list[str] = field(default_factory=list)
    """(S,) which state each innovation belongs to."""
    plays: list[Play] = field(default_factory=list)
    switches: list[Switch] = field(default_factory=list)


def read_truth(path: Path, reference: np.ndarray) -> FlightTrace:
    """Read what the bridge recorded (``sim_bridge.truth``); reference: (T, 3) [rad] of the whole planned flight.

    Raises UserError when the file is missing or is no such record.
    """
    try:
        with np.load(path, allow_pickle=False) as truth:
            time_us, x, surfaces = truth["time_us"], truth["x"], truth["surfaces"]
            command, faults = truth["command"], truth["faults"]
    except FileNotFoundError:
        raise UserError(f"{path}: no true states; the flight did not end; fly it again with --fresh") from None
    except (KeyError, ValueError, OSError, EOFError, BadZipFile) as error:
        raise UserError(f"{path}: not a record of the bridge: {error}; fly it again with --fresh") from None
    samples = min(len(x), len(reference))
    held = np.concatenate([command, command[-1:]])[:samples] if len(command) else np.zeros((samples, len(ACTION)))
    return FlightTrace(
        time=time_us[:samples] * 1e-6,
        x=x[:samples],
        reference=reference[:samples],
        command=held,
        surfaces=surfaces[:samples],
        faulty=faults[:samples].any(axis=1),
        planned_samples=len(reference),
        onsets=_onsets(time_us[:samples] * 1e-6, faults[:samples] > 0.0),
    )


def _onsets(time: np.ndarray, acting: np.ndarray) -> tuple[float, ...]:
    """Return when each fault begins [s]; time: (T,) [s]; acting: (T, F) bool."""
    before = np.vstack([np.zeros((1, acting.shape[1]), dtype=bool), acting[:-1]])
    return tuple(float(time[k]) for k in np.nonzero(acting & ~before)[0])


def read_log(path: Path) -> AdaptationTrace:
    """Read the runtime's flight log (ULog). Raises UserError when it is missing or lacks what belongs in it."""
    if not path.is_file():
        raise UserError(f"{path}: no flight log; the runtime did not fly; fly it again with --fresh")
    try:
        with path.open("rb") as file:
            log = ULog(file)
        topics = {data.name: data.data for data in log.data_list}
        cycle, innovation = topics["cycle"], topics["innovation"]
        members = msgspec.json.decode(log.msg_info_dict["members"], type=list[str])
    except Exception as error:  # pyulog raises whatever its parser stumbles over
        raise UserError(f"{path}: not a flight log of the runtime: {error!r}; fly it again with --fresh") from None
    # A log that was cut off may end between the two topics of a cycle.
    whole = min(len(cycle["timestamp"]), len(innovation["timestamp"]))
    names = [s.name for s in STATE if s.name in innovation]
    play = topics.get("play")
    plays, switches = [], []
    if play is not None:
        returns = np.stack([play[f"returns[{i}]"] for i in range(len(members) + 1)], axis=1)
        time = play["timestamp"] * 1e-6
        plays = [Play(float(t), r) for t, r in zip(time, returns, strict=True)]
        changed = np.flatnonzero(play["action"])
        switches = [Switch(float(time[i]), int(play["member"][i])) for i in changed]
    return AdaptationTrace(
        time=cycle["timestamp"][:whole] * 1e-6,
        active=cycle["member"][:whole].astype(int),
        innovation=np.stack([innovation[name][:whole] for name in names], axis=1).astype(float),
        members=members,
        innovation_names=names,
        plays=plays,
        switches=switches,
    )
