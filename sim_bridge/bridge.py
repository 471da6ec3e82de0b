"""The cycle of a flight: record, send, take the command, step."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Literal

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from sim_bridge.codec import Codec, Status
from sim_bridge.exchange import TICK_US, Ends, Exchange, Lockstep, NoRuntimeError, RealTime, StoppedError, Timing
from sim_bridge.flight import Flight
from sim_bridge.inbox import Counts, Inbox
from sim_bridge.link import Link
from sim_bridge.pace import Pace
from sim_bridge.sender import Sender
from sim_bridge.truth import Truth
from sim_bridge.world import World
from task.limits import DT
from task.reference import n_samples
from task.reward import terminated

Outcome = Literal["complete", "aircraft lost", "stopped", "no runtime"]


class Percentiles(msgspec.Struct):
    """A distribution of durations [us]."""

    p50: float
    p99: float
    p999: float
    worst: float


class Summary(msgspec.Struct):
    """How a flight went on the bridge's side."""

    outcome: Outcome
    reason: str
    """Why it ended early; empty when it is complete."""
    ticks: int
    """Commands applied."""
    planned_ticks: int
    seed: int
    lockstep: bool
    wall_seconds: float
    """From the first reply to the end."""
    link: Counts
    response_us: Percentiles | None
    """From a state to its reply, as the bridge saw it."""
    jitter_us: Percentiles | None
    """How late the bridge woke at its deadlines (real time)."""


def percentiles(seconds: np.ndarray) -> Percentiles | None:
    """Return the distribution of durations (n,) [s] in microseconds; None when there are none."""
    if not seconds.size:
        return None
    return Percentiles(*(round(float(v) * 1e6, 1) for v in np.quantile(seconds, [0.5, 0.99, 0.999, 1.0])))


def new_reset_counter() -> int:
    """Return 0..255, unlike that of the bridge that ran before on this machine as far as 256 values allow."""
    return (os.getpid() + time.time_ns() // 1_000_000_000) % 256


class Bridge:
    """One flight behind MAVLink.

    flight: what is flown; link: to the runtime; realtime: wall clock instead of lockstep; stopped: asked at least
    ten times a second whether to end the flight; say: takes one line at each event on the link.
    """

    def __init__(
        self,
        flight: Flight,
        link: Link,
        realtime: bool = False,
        timing: Timing | None = None,
        stopped: Callable[[], bool] = lambda: False,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._flight = flight
        self._realtime = realtime
        self._ticks = n_samples(flight.duration)
        self._world = World(flight)
        self._counts = Counts()
        codec = Codec(self._world.origin_altitude, new_reset_counter())
        self._sender = Sender(link, codec, lockstep=not realtime)
        self._pace = Pace(DT, self._ticks)
        inbox = Inbox(link, codec, self._counts, self._order)
        trim = self._world.trim_action
        ends = Ends(link, self._sender, inbox, self._counts, timing or Timing(), trim, stopped, say)
        self._exchange: Exchange = RealTime(ends, self._pace) if realtime else Lockstep(ends)
        self.truth = Truth(self._ticks, self._world.fault_names)
        """What truly happened; whole whatever the outcome."""

    def fly(self) -> Summary:
        """Fly to the end, whichever it is, tell the runtime, and return how it went."""
        outcome: Outcome
        reason = ""
        try:
            outcome = self._cycle()
            if outcome == "aircraft lost":
                reason = f"the aircraft was lost at {self.truth.ticks * DT:.2f} s"
        except StoppedError:
            outcome, reason = "stopped", f"stopped at {self.truth.ticks * DT:.2f} s"
        except NoRuntimeError as error:
            outcome, reason = "no runtime", str(error)
        began = self._exchange.connected_at
        wall = time.perf_counter() - began if began else 0.0
        self._sender.farewell(Status.AIRCRAFT_LOST if outcome == "aircraft lost" else Status.OVER)
        return Summary(
            outcome=outcome,
            reason=reason,
            ticks=self.truth.ticks,
            planned_ticks=self._ticks,
            seed=self._flight.seed,
            lockstep=not self._realtime,
            wall_seconds=round(wall, 3),
            link=self._counts,
            response_us=percentiles(np.array(self._exchange.response)),
            jitter_us=percentiles(self._pace.lateness()) if self._realtime else None,
        )

    def _order(self, message: mavlink.MAVLink_command_long_message) -> int:
        """Carry out a command of a ground station; return its MAV_RESULT."""
        result = self._world.inject(message)
        self.truth.name_faults(self._world.fault_names)
        return result

    def _cycle(self) -> Outcome:
        world, truth = self._world, self.truth
        for k in range(self._ticks + 1):
            time_us = k * TICK_US
            truth.state(time_us, world.x, world.surfaces, world.wind_n, world.fault_levels)
            if terminated(world.x):
                return "aircraft lost"
            if k == self._ticks:
                break
            self._sender.tick(time_us, world.measured, world.wind_n)
            command = self._exchange.command(time_us)
            truth.command(command, self._exchange.echo)
            world.step(command)
        return "complete"
