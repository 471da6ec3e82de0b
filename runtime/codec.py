"""The runtime's own codec for the two frames of every tick: ODOMETRY in, HIL_ACTUATOR_CONTROLS out.

Written by hand with ``struct`` from the MAVLink 2 specification, an order of magnitude cheaper than the generated
classes; the other messages go through those. ``tests/contract`` pins it to them byte for byte.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np
from fastcrc.crc16 import mcrf4xx

from task.limits import DEFLECTION_LIMIT
from task.state import N_ACTION, N_STATE

MAGIC_2, MAGIC_1 = 0xFD, 0xFE
HEADER = 10
CHECKSUM = 2
SIGNATURE = 13
SIGNED = 0x01

ODOMETRY, HIL_ACTUATOR_CONTROLS = 331, 93
ODOMETRY_EXTRA, HIL_ACTUATOR_CONTROLS_EXTRA = b"\x5b", b"\x2f"
"""CRC_EXTRA of each message: a digest of its fields, so that another dialect's layout does not pass the checksum."""

LOCAL_NED, BODY_FRD = 1, 12
ARMED = 128
LOCKSTEP = 1

_ODOMETRY = struct.Struct("<Q13f168x5B")
_CONTROLS = struct.Struct("<BBBBBBBHBQQ3f52xB")
_U16 = struct.Struct("<H")
NAN = float("nan")


class Frame(NamedTuple):
    """Where one MAVLink 2 frame lies in a datagram, and whose it is."""

    start: int
    length: int
    """Of the payload [bytes]."""
    message: int
    system: int
    component: int
    end: int
    """One past its last byte, signature included."""


def next_frame(data: bytearray, start: int, end: int) -> Frame | None:
    """Return the MAVLink 2 frame at ``start`` of data[:end]; None when there is no whole one."""
    if end - start < HEADER + CHECKSUM or data[start] != MAGIC_2 or data[start + 2] & ~SIGNED:
        return None
    length = data[start + 1]
    stop = start + HEADER + length + CHECKSUM + (SIGNATURE if data[start + 2] & SIGNED else 0)
    if stop > end:
        return None
    message = data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16
    return Frame(start, length, message, data[start + 5], data[start + 6], stop)


def checksum_holds(data: bytearray, frame: Frame, extra: bytes) -> bool:
    """Return whether the frame's checksum is right for the message layout that ``extra`` stands for."""
    stop = frame.start + HEADER + frame.length
    crc = mcrf4xx(extra, mcrf4xx(bytes(data[frame.start + 1 : stop])))
    return crc == data[stop] | data[stop + 1] << 8


class Odometry:
    """One ODOMETRY, read in place: nothing of it is kept from one frame to the next.

    ``x`` (12,) is the aircraft state of ``task.state``, filled by :meth:`read`; what the sender does not know is NaN.
    """

    def __init__(self) -> None:
        self.time_usec = 0
        self.frame_id = 0
        self.child_frame_id = 0
        self.reset_counter = 0
        self.quality = 0
        self.x = np.zeros(N_STATE)
        self._payload = bytearray(_ODOMETRY.size)

    def read(self, data: bytearray, frame: Frame, origin_altitude: float) -> None:
        """Fill from a frame whose checksum holds; trailing zeros that the sender cut off are put back.

        V = |v|, alpha = atan2(w, u), beta = asin(v / V) from the body-frame velocity over ground; phi, theta, psi are
        the z-y-x Euler angles of the quaternion; h = origin altitude - z.
        """
        payload = self._payload
        first = frame.start + HEADER
        length = min(frame.length, len(payload))
        payload[:length] = data[first : first + length]
        payload[length:] = bytes(len(payload) - length)
        (
            self.time_usec, x, y, z, q0, q1, q2, q3, u, v, w, p, q, r,
            self.frame_id, self.child_frame_id, self.reset_counter, _, self.quality,
        ) = _ODOMETRY.unpack(payload)  # fmt: skip
        V = math.sqrt(u * u + v * v + w * w)
        alpha = math.atan2(w, u)
        beta = _asin(v / V) if V > 0.0 else 0.0 * V
        phi, theta, psi = euler(q0, q1, q2, q3)
        self.x[:] = (p, q, r, V, alpha, beta, phi, theta, psi, origin_altitude - z, x, y)


def _asin(value: float) -> float:
    """Return the arc sine [rad] of what rounding may have carried past one; NaN stays NaN."""
    return math.asin(value) if -1.0 <= value <= 1.0 else math.copysign(0.5 * math.pi, value) if value == value else NAN


def euler(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return phi, theta, psi [rad] of the attitude quaternion (body to north-east-down), normalised here.

    NaN when it is no attitude: not finite, or its norm is off by more than rounding can explain.
    """
    norm = w * w + x * x + y * y + z * z
    if not 0.98 < norm < 1.02:
        return NAN, NAN, NAN
    return (
        math.atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z),
        _asin(2.0 * (w * y - z * x) / norm),
        math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z),
    )


class Controls:
    """HIL_ACTUATOR_CONTROLS from one system and component, packed in place."""

    def __init__(self, system: int, component: int, lockstep: bool) -> None:
        self._identity = (system, component)
        self._flags = LOCKSTEP if lockstep else 0
        self._frame = bytearray(_CONTROLS.size + CHECKSUM)

    def pack(self, sequence: int, time_usec: int, action: np.ndarray) -> bytearray:
        """Return the frame for a command (3,) [rad] within ``task.limits``; reused at the next call.

        ``time_usec`` echoes the ODOMETRY that was used. The message ends in a byte that is not zero, so that MAVLink
        2 has nothing to truncate.
        """
        frame = self._frame
        e, a, r = (min(max(float(action[i]) / DEFLECTION_LIMIT, -1.0), 1.0) for i in range(N_ACTION))
        payload = len(frame) - HEADER - CHECKSUM
        _CONTROLS.pack_into(
            frame, 0, MAGIC_2, payload, 0, 0, sequence, *self._identity, HIL_ACTUATOR_CONTROLS, 0,
            time_usec, self._flags, e, a, r, ARMED,
        )  # fmt: skip
        crc = mcrf4xx(HIL_ACTUATOR_CONTROLS_EXTRA, mcrf4xx(bytes(frame[1:-CHECKSUM])))
        _U16.pack_into(frame, len(frame) - CHECKSUM, crc)
        return frame
