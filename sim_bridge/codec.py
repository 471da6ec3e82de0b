"""The bridge's side of docs/interface.md: states to MAVLink frames, MAVLink frames to commands.

Speaks through pymavlink's generated classes alone. The runtime packs and parses its frames by hand;
two unlike codecs cannot share an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from task.errors import UserError
from task.limits import DEFLECTION_LIMIT
from task.state import ACTION

SYSTEM = 1
COMPONENT = mavlink.MAV_COMP_ID_IMU
"""Identity of the bridge on the link; the runtime is system 1, component 1."""

ORIGIN_LATITUDE = 52.3086
ORIGIN_LONGITUDE = 4.7639
"""Where the flight begins [deg]; nothing in it depends on the place."""

LOCKSTEP_FLAG = mavlink.HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
QUALITY = 100

NAN = float("nan")
_LARGEST = 1e30
"""Beyond this a value is sent as NaN: it would not fit a float32, and no aircraft is there."""


class Status:
    """HEARTBEAT.system_status of the bridge."""

    WAITING = mavlink.MAV_STATE_STANDBY
    FLYING = mavlink.MAV_STATE_ACTIVE
    AIRCRAFT_LOST = mavlink.MAV_STATE_FLIGHT_TERMINATION
    OVER = mavlink.MAV_STATE_POWEROFF


class Command(NamedTuple):
    """A HIL_ACTUATOR_CONTROLS, read."""

    time_us: int
    """Time of the state that it answers [us]."""
    action: np.ndarray | None
    """Elevator, aileron, rudder [rad], shape (3,); None when it is refused."""
    refusal: str
    """Why it is refused; empty when it is not."""


def require_fast_checksums() -> None:
    """Raise UserError unless pymavlink computes its checksums with fastcrc: without it a frame costs 0.2 ms."""
    if mavlink.x25crc.__name__ != "_x25crc_fast":
        raise UserError("pymavlink does not use fastcrc, so each frame would cost 0.2 ms; pip install fastcrc")


def quaternion(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """Return the attitude (w, x, y, z) that turns body axes into north-east-down; angles [rad], order z-y-x."""
    cos_phi, sin_phi = math.cos(0.5 * phi), math.sin(0.5 * phi)
    cos_theta, sin_theta = math.cos(0.5 * theta), math.sin(0.5 * theta)
    cos_psi, sin_psi = math.cos(0.5 * psi), math.sin(0.5 * psi)
    return (
        cos_phi * cos_theta * cos_psi + sin_phi * sin_theta * sin_psi,
        sin_phi * cos_theta * cos_psi - cos_phi * sin_theta * sin_psi,
        cos_phi * sin_theta * cos_psi + sin_phi * cos_theta * sin_psi,
        cos_phi * cos_theta * sin_psi - sin_phi * sin_theta * cos_psi,
    )


def body_velocity(V: float, alpha: float, beta: float) -> tuple[float, float, float]:
    """Return u, v, w [m/s] of a velocity given as speed [m/s] and angles [rad].

    The inverse of V = |(u, v, w)|, alpha = atan2(w, u), beta = asin(v / V).
    """
    forward = V * math.cos(beta)
    return forward * math.cos(alpha), V * math.sin(beta), forward * math.sin(alpha)


class Codec:
    """One end of the link: holds the sequence counter and the messages that are sent every tick.

    origin_altitude: altitude [m] of the origin of the local frame, a whole number of millimetres.
    reset_counter: 0..255, another one at every start of a bridge.
    """

    def __init__(self, origin_altitude: float, reset_counter: int) -> None:
        self._mav = mavlink.MAVLink(None, SYSTEM, COMPONENT)
        self._origin_altitude = origin_altitude
        unknown = [NAN] + [0.0] * 20
        self._odometry = mavlink.MAVLink_odometry_message(
            time_usec=0,
            frame_id=mavlink.MAV_FRAME_LOCAL_NED,
            child_frame_id=mavlink.MAV_FRAME_BODY_FRD,
            x=0.0,
            y=0.0,
            z=0.0,
            q=(1.0, 0.0, 0.0, 0.0),
            vx=0.0,
            vy=0.0,
            vz=0.0,
            rollspeed=0.0,
            pitchspeed=0.0,
            yawspeed=0.0,
            pose_covariance=unknown,
            velocity_covariance=unknown,
            reset_counter=reset_counter,
            estimator_type=mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
            quality=QUALITY,
        )

    def _pack(self, message: mavlink.MAVLink_message) -> bytes:
        frame = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def odometry(self, time_us: int, x: np.ndarray) -> bytes:
        """Return ODOMETRY of the state x (12,) (task.state) at ``time_us`` [us]; what is not finite goes as NaN."""
        p, q, r, V, alpha, beta, phi, theta, psi, h, xe, ye = (
            value if -_LARGEST < value < _LARGEST else NAN for value in x.tolist()
        )
        message = self._odometry
        message.time_usec = time_us
        message.x, message.y, message.z = xe, ye, self._origin_altitude - h
        message.q = quaternion(phi, theta, psi)
        message.vx, message.vy, message.vz = body_velocity(V, alpha, beta)
        message.rollspeed, message.pitchspeed, message.yawspeed = p, q, r
        return self._pack(message)

    def wind(self, time_us: int, wind_n: np.ndarray, altitude: float) -> bytes:
        """Return WIND_COV: the air's velocity over the ground (3,), north-east-down [m/s], at an altitude [m]."""
        north, east, down = wind_n.tolist()
        return self._pack(mavlink.MAVLink_wind_cov_message(time_us, north, east, down, NAN, NAN, altitude, NAN, NAN))

    def origin(self, time_us: int) -> bytes:
        """Return GPS_GLOBAL_ORIGIN: where x = y = z = 0 lies."""
        return self._pack(
            mavlink.MAVLink_gps_global_origin_message(
                round(ORIGIN_LATITUDE * 1e7),
                round(ORIGIN_LONGITUDE * 1e7),
                round(self._origin_altitude * 1e3),
                time_us,
            )
        )

    def heartbeat(self, status: int, lockstep: bool) -> bytes:
        """Return HEARTBEAT with one of :class:`Status`; custom_mode 1 says that the bridge waits for replies."""
        return self._pack(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_FIXED_WING,
                mavlink.MAV_AUTOPILOT_INVALID,
                mavlink.MAV_MODE_FLAG_HIL_ENABLED,
                int(lockstep),
                status,
                3,
            )
        )

    def acknowledge(self, command: int, result: int, system: int, component: int) -> bytes:
        """Return COMMAND_ACK for a command [MAV_CMD] with its result [MAV_RESULT] to who gave it."""
        return self._pack(mavlink.MAVLink_command_ack_message(command, result, 0, 0, system, component))

    def messages(self, datagram: bytes) -> Iterator[mavlink.MAVLink_message | str]:
        """Yield each frame of a datagram as its message, or as a string that says why it cannot be read.

        Never raises: whatever arrives over the link is counted, not trusted.
        """
        rest = bytearray(datagram)
        while rest:
            size = _frame_size(rest)
            if size is None or size > len(rest):
                yield f"{len(rest)} bytes that are no MAVLink frame"
                return
            frame, rest = rest[:size], rest[size:]
            try:
                message = self._mav.decode(frame)
            except mavlink.MAVError as error:
                yield str(error)
                continue
            yield message


def _frame_size(data: bytearray) -> int | None:
    """Return the length [bytes] of the frame that begins here; None when none does."""
    if len(data) < 3:
        return None
    if data[0] == mavlink.PROTOCOL_MARKER_V2:
        signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if data[2] & mavlink.MAVLINK_IFLAG_SIGNED else 0
        return mavlink.HEADER_LEN_V2 + data[1] + 2 + signature
    if data[0] == mavlink.PROTOCOL_MARKER_V1:
        return mavlink.HEADER_LEN_V1 + data[1] + 2
    return None


def read_command(message: mavlink.MAVLink_hil_actuator_controls_message) -> Command:
    """Return the command in a HIL_ACTUATOR_CONTROLS: controls[0..2] are de, da, dr over DEFLECTION_LIMIT."""
    controls = message.controls[: len(ACTION)]
    if not message.mode & ARMED:
        return Command(message.time_usec, None, "not armed")
    if not all(map(math.isfinite, controls)):
        return Command(message.time_usec, None, "not finite")
    if not all(-1.0 <= control <= 1.0 for control in controls):
        return Command(message.time_usec, None, "out of range")
    return Command(message.time_usec, np.array(controls) * DEFLECTION_LIMIT, "")
