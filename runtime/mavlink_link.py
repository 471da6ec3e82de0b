"""MAVLink 2 over UDP as the loop's link (docs/interface.md)."""

from __future__ import annotations

import select
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from runtime.codec import (
    BODY_FRD,
    LOCAL_NED,
    MAGIC_1,
    MAGIC_2,
    NAN,
    ODOMETRY,
    ODOMETRY_EXTRA,
    Controls,
    Frame,
    Odometry,
    checksum_holds,
    euler,
    next_frame,
)
from runtime.link import LOST, OVER, Sample
from runtime.udp import Address, Peer, open_socket, resolve
from task.errors import UserError
from task.state import N_ACTION

SYSTEM, COMPONENT = 1, 1
"""The runtime is the autopilot."""

TEXT = 50
"""Characters that fit in one STATUSTEXT."""


Sender = tuple[Peer, tuple[int, int]]
"""An address, and the system and component that speak from it."""


class MavlinkLink:
    """MAVLink 2 over UDP.

    In lockstep every state is handed over, of several in one datagram the last; in real time the newest one that is
    there. Older ones are counted in ``skipped``. A state that was answered and comes again is answered again from here.
    ``say_here`` takes the lines meant for who started the runtime; ``on_setpoint`` takes theta, phi [rad].
    """

    HEARTBEAT_PERIOD = 1.0
    PEER_SILENCE = 1.0
    """While one aircraft has spoken within this time [s], the states of another are not heard."""
    OUT_OF_ORDER = 100_000
    """In real time a state that is older than another by less than this [us] was overtaken on the way."""
    BURST = 64
    """Datagrams that are read at most to find the newest state."""
    SENDERS = 16
    """Whose origins are kept: an aircraft that takes another's place has told its own before its first state."""
    LINES = 64
    """Different things that are counted and said; beyond, they are one."""
    FLOOD = 2000
    """Messages of no use in a second that are worth a line."""

    def __init__(
        self,
        address: Address,
        lockstep: bool,
        say_here: Callable[[str], None] = lambda line: None,
        on_setpoint: Callable[[float, float], None] | None = None,
    ) -> None:
        if mavlink.x25crc.__name__ != "_x25crc_fast":
            raise UserError("pymavlink does not use fastcrc, so each message would cost 0.2 ms; pip install fastcrc")
        self.address = address
        self.ended = ""
        self.skipped = 0
        self.repeated = 0
        self.refused: Counter[str] = Counter()
        """What was not taken, and why."""
        self.heard: Counter[str] = Counter()
        """Messages by name that are of no use here."""
        self._lockstep = lockstep
        self._say_here = say_here
        self._on_setpoint = on_setpoint
        self._said: set[str] = set()
        self._mav = mavlink.MAVLink(None, SYSTEM, COMPONENT)
        self._controls = Controls(SYSTEM, COMPONENT, lockstep)
        self._odometry = Odometry()
        self._origins: dict[Sender, float] = {}
        """Altitude of each sender's origin [m], the one told last at the end."""
        self._peer: Peer | None = None if address.bind else resolve(address)
        """Whose states are flown."""
        self._caller: Peer | None = None
        """Who spoke last: is told that we are here while there is no peer."""
        self._aircraft = (-1, -1)
        self._peer_heard = -1e9
        self._last = ("", -1e9)
        """What came last, and when."""
        self._flight = -1
        self._newest_usec = -1
        self._answered = (-1, -1)
        self._answer = np.zeros(N_ACTION)
        self._next_heartbeat = 0.0
        self._flood = 0
        self._texts = 0
        self._buffer = bytearray(65536)
        self._socket = open_socket(address)
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)

    def read(self, timeout: float) -> Sample | None:
        """Return the next state, in real time the newest; None when none comes or the flight ended."""
        deadline = time.monotonic() + timeout
        while True:
            now = time.monotonic()
            self._housekeeping(now)
            left = max(deadline - now, 0.0)
            if not self._poll.poll(1e3 * min(left, self.HEARTBEAT_PERIOD)):
                if left <= 0.0:
                    return None
                continue
            sample = self._receive()
            if self.ended:
                return None
            if sample is not None:
                return sample if self._lockstep else self._newest(sample)
            if time.monotonic() >= deadline:
                return None

    def _newest(self, sample: Sample) -> Sample | None:
        """Return the last of the states that wait; the older ones are skipped and counted."""
        for _ in range(self.BURST):
            if not self._poll.poll(0):
                break
            newer = self._receive()
            if self.ended:
                return None
            if newer is not None:
                self.skipped += 1
                sample = newer
        return sample

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Send the command (3,) [rad], echoing the time of the state that it answers."""
        np.copyto(self._answer, action)
        self._answered = (self._flight, time_usec)
        self._send(self._controls.pack(self._next_sequence(), time_usec, action))

    def say(self, text: str, severity: int) -> None:
        """Send STATUSTEXT; a long text goes in chunks."""
        raw = text.encode("ascii", "replace")
        self._texts += 1
        number = 0 if len(raw) <= TEXT else 1 + self._texts % 65535
        for chunk, first in enumerate(range(0, len(raw), TEXT)):
            part = raw[first : first + TEXT]
            self._send(self._pack(mavlink.MAVLink_statustext_message(severity, part, number, chunk)))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def diagnosis(self) -> str:
        """Return in words what came instead of a state."""
        if self.refused:
            return "; ".join(f"{count} x {why}" for why, count in self.refused.most_common(3))
        if self.heard:
            names = ", ".join(f"{count} x {name}" for name, count in self.heard.most_common(4))
            return f"heard only {names}: is this the aircraft's side of docs/interface.md?"
        if self.address.bind:
            return "nothing came at all: is the aircraft's side started, and sent to this address?"
        return "nothing came back: is the aircraft's side listening there?"

    def silence(self) -> str:
        """Return in words for how long no state has come to a flight, and what came last."""
        now, (what, at) = time.monotonic(), self._last
        return f"no state for {now - self._peer_heard:.1f} s; what came last, {now - at:.1f} s ago, was {what}"

    def _next_sequence(self) -> int:
        sequence = self._mav.seq
        self._mav.seq = (sequence + 1) & 0xFF
        return sequence

    def _pack(self, message: mavlink.MAVLink_message) -> bytes:
        frame = message.pack(self._mav)
        self._next_sequence()
        return frame

    def _send(self, frame: bytes | bytearray, to: Peer | None = None) -> None:
        peer = to or self._peer or self._caller
        if peer is None:
            return
        try:
            self._socket.sendto(frame, peer)
        except OSError:
            self.refused["datagram that the network would not take"] += 1

    def _housekeeping(self, now: float) -> None:
        """Once a second: HEARTBEAT, and a line if the link is flooded."""
        if now < self._next_heartbeat:
            return
        self._next_heartbeat = now + self.HEARTBEAT_PERIOD
        if self._flood > self.FLOOD:
            self._once(f"link: {self._flood} messages of no use in a second, mostly {self.heard.most_common(1)[0][0]}")
        self._flood = 0
        self._send(
            self._pack(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_FIXED_WING,
                    mavlink.MAV_AUTOPILOT_GENERIC,
                    mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED,
                    0,
                    mavlink.MAV_STATE_ACTIVE,
                    3,
                )
            )
        )

    def _once(self, line: str, key: str = "") -> None:
        """Say a line to who started the runtime, once."""
        key = key or line
        if key not in self._said and len(self._said) < self.LINES:
            self._said.add(key)
            self._say_here(line)

    def _refuse(self, why: str) -> None:
        self._last = f"refused: {why}", time.monotonic()
        self.refused[why if why in self.refused or len(self.refused) < self.LINES else "more of other kinds"] += 1
        self._once(f"link: refused: {why}", why)

    def _receive(self) -> Sample | None:
        """Take one datagram; return the last state in it, the others being skipped and counted."""
        try:
            size, peer = self._socket.recvfrom_into(self._buffer)
        except OSError:
            return None
        self._caller = peer
        data, start, sample = self._buffer, 0, None
        while start < size:
            frame = next_frame(data, start, size)
            if frame is None:
                self._refuse(_what_is_it(data, start, peer))
                break
            start = frame.end
            if frame.message == ODOMETRY:
                state = self._take_odometry(frame, peer)
                self.skipped += state is not None and sample is not None
                sample = state or sample
            else:
                self._take_other(frame, peer)
        return sample

    def _take_odometry(self, frame: Frame, peer: Peer) -> Sample | None:
        """Return the state in an ODOMETRY; None when it is refused or was answered already."""
        if not checksum_holds(self._buffer, frame, ODOMETRY_EXTRA):
            self._refuse(f"ODOMETRY of {peer[0]}:{peer[1]} with a wrong checksum: damaged, or another MAVLink dialect")
            return None
        identity = (frame.system, frame.component)
        origin = self._origins.get((peer, identity))
        odometry = self._odometry
        odometry.read(self._buffer, frame, NAN if origin is None else origin)
        if odometry.frame_id != LOCAL_NED or odometry.child_frame_id != BODY_FRD:
            self._refuse(
                f"ODOMETRY in frames {odometry.frame_id}, {odometry.child_frame_id}: expected {LOCAL_NED} "
                f"(MAV_FRAME_LOCAL_NED), {BODY_FRD} (MAV_FRAME_BODY_FRD)"
            )
            return None
        if origin is None:
            self._refuse(
                f"ODOMETRY before any GPS_GLOBAL_ORIGIN of {peer[0]}:{peer[1]} system {frame.system} component "
                f"{frame.component}: its altitude is unknown"
            )
            return None
        now = time.monotonic()
        if (peer, identity) != (self._peer, self._aircraft):
            if now - self._peer_heard < self.PEER_SILENCE:
                self._refuse(f"ODOMETRY of a second aircraft, {peer[0]}:{peer[1]} system {frame.system}")
                return None
            self._peer, self._aircraft = peer, identity
        self._peer_heard = now
        self._last = "ODOMETRY", now
        if (odometry.reset_counter, odometry.time_usec) == self._answered:
            self.repeated += 1
            self._send(self._controls.pack(self._next_sequence(), odometry.time_usec, self._answer))
            return None
        late = self._newest_usec - odometry.time_usec
        if not self._lockstep and odometry.reset_counter == self._flight and 0 < late < self.OUT_OF_ORDER:
            self._refuse("ODOMETRY out of order")
            return None
        self._flight, self._newest_usec = odometry.reset_counter, odometry.time_usec
        return Sample(odometry.time_usec, odometry.reset_counter, odometry.x.copy())

    def _take_other(self, frame: Frame, peer: Peer) -> None:
        """Take a message that is no state; what is of no use is counted unread."""
        name = mavlink.mavlink_map[frame.message].msgname if frame.message in mavlink.mavlink_map else "unknown"
        self._last = name, time.monotonic()
        handler = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._take_heartbeat,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._take_origin,
            mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._take_setpoint,
        }.get(frame.message)
        if handler is None:
            if frame.message != mavlink.MAVLINK_MSG_ID_WIND_COV:
                self.heard[name] += 1
                self._flood += 1
            return
        try:
            message = self._mav.decode(self._buffer[frame.start : frame.end])
        except (mavlink.MAVError, ValueError):
            self._refuse(f"{name} of {peer[0]}:{peer[1]} that cannot be read: damaged, or another MAVLink dialect")
            return
        handler(message, frame, peer)

    def _take_heartbeat(self, message: mavlink.MAVLink_heartbeat_message, frame: Frame, peer: Peer) -> None:
        """Hear how the aircraft's side is; only the one that flies can end the flight."""
        self.heard["HEARTBEAT"] += 1
        if (frame.system, frame.component) != self._aircraft or peer != self._peer:
            return
        if message.system_status == mavlink.MAV_STATE_POWEROFF:
            self.ended = OVER
        elif message.system_status == mavlink.MAV_STATE_FLIGHT_TERMINATION:
            self.ended = LOST
        elif bool(message.custom_mode) and not self._lockstep:
            self._once("link: the aircraft's side keeps lockstep but the runtime real time; leave out --realtime")

    def _take_origin(self, message: mavlink.MAVLink_gps_global_origin_message, frame: Frame, peer: Peer) -> None:
        """Learn the altitude of the sender's own origin; nobody else's states are of it."""
        sender = peer, (frame.system, frame.component)
        aircraft = self._peer, self._aircraft
        if sender != aircraft and time.monotonic() - self._peer_heard < self.PEER_SILENCE:
            self._once(f"link: GPS_GLOBAL_ORIGIN of {peer[0]}:{peer[1]} system {frame.system} is not the aircraft's")
        self._origins.pop(sender, None)
        self._origins[sender] = 1e-3 * message.altitude
        if len(self._origins) > self.SENDERS:
            del self._origins[next(known for known in self._origins if known != aircraft)]

    def _take_setpoint(self, message: mavlink.MAVLink_set_attitude_target_message, frame: Frame, peer: Peer) -> None:
        """Take a set-point of attitude, and say it back as ATTITUDE_TARGET."""
        if self._on_setpoint is None:
            self._once("link: SET_ATTITUDE_TARGET ignored: the reference comes from a file")
            return
        no_attitude = mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE
        phi, theta, _ = euler(*message.q)
        if message.type_mask & no_attitude or message.type_mask & 7 != 7 or message.target_system not in (0, SYSTEM):
            self._refuse(
                f"SET_ATTITUDE_TARGET with type_mask {message.type_mask}: expected 7, an attitude without rates"
            )
            return
        if not (np.isfinite(theta) and np.isfinite(phi)):
            self._refuse("SET_ATTITUDE_TARGET with a quaternion that is no attitude")
            return
        self._on_setpoint(theta, phi)
        target = mavlink.MAVLink_attitude_target_message(
            message.time_boot_ms, message.type_mask, message.q, 0.0, 0.0, 0.0, message.thrust
        )
        self._send(self._pack(target), peer)


def _what_is_it(data: bytearray, start: int, peer: Peer) -> str:
    """Return in words what cannot be a MAVLink 2 frame."""
    sender = f"{peer[0]}:{peer[1]}"
    if data[start] == MAGIC_1:
        return f"MAVLink 1 of {sender}, which cannot carry ODOMETRY: set it to MAVLink 2"
    return f"damaged frame of {sender}" if data[start] == MAGIC_2 else f"bytes of {sender} that are no MAVLink 2 frame"
