"""What comes back over the link, sorted: commands are handed on, everything else is counted."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable

import msgspec
from pymavlink.dialects.v20 import common as mavlink

from sim_bridge.codec import SYSTEM, Codec, Command, read_command
from sim_bridge.link import Link

_DATAGRAMS_A_CALL = 64
EVERYBODY = 0
"""The target system of a command that is for all."""


class Counts(msgspec.Struct):
    """What went wrong on the link in one flight."""

    late: int = 0
    """Ticks whose own command had not come in time."""
    longest_late_run: int = 0
    """Most late ticks in a row."""
    stale: int = 0
    """Replies to a tick that was already over."""
    refused: Counter[str] = msgspec.field(default_factory=Counter)
    """Commands refused, by reason."""
    unreadable: int = 0
    """Frames that could not be read."""
    reconnections: int = 0
    """Times that the runtime came back after the link was lost."""
    overruns: int = 0
    """Ticks of wall clock that were missed and skipped (real time)."""


class Inbox:
    """Reads the link and hands on the commands in it.

    order: carries out a COMMAND_LONG and returns its MAV_RESULT.
    """

    def __init__(
        self, link: Link, codec: Codec, counts: Counts, order: Callable[[mavlink.MAVLink_command_long_message], int]
    ) -> None:
        self._link = link
        self._codec = codec
        self._counts = counts
        self._order = order
        self._pending: deque[Command] = deque()
        self._heartbeats = 0
        self._last_unreadable = ""

    def next(self, until: float) -> Command | None:
        """Return the next command; None when none comes by ``until`` [s, time.perf_counter] or the port is closed.

        None also after a flood of datagrams without a command, so that no sender can hold the cycle up.
        """
        for _ in range(_DATAGRAMS_A_CALL):
            if self._pending:
                return self._pending.popleft()
            datagram = self._link.receive(until)
            if datagram is None:
                return None
            for message in self._codec.messages(datagram):
                self._sort(message)
        return None

    def _sort(self, message: mavlink.MAVLink_message | str) -> None:
        if isinstance(message, str):
            self._counts.unreadable += 1
            self._last_unreadable = message
            return
        kind = message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
            self._pending.append(read_command(message))
        elif kind == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
            if message.target_system not in (EVERYBODY, SYSTEM):
                return
            sender = message.get_srcSystem(), message.get_srcComponent()
            self._link.send(self._codec.acknowledge(message.command, self._order(message), *sender))
        elif kind == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self._heartbeats += 1

    def heard(self) -> str:
        """Return in words what has come over the link, for the line that says why a flight was given up."""
        parts = []
        if self._heartbeats:
            parts.append(f"{self._heartbeats} HEARTBEAT")
        if self._counts.refused:
            parts.append(
                "refused commands (" + ", ".join(f"{n} {why}" for why, n in self._counts.refused.items()) + ")"
            )
        if self._counts.unreadable:
            parts.append(f"{self._counts.unreadable} unreadable frames (last: {self._last_unreadable})")
        return "heard " + ", ".join(parts) if parts else "heard nothing"
