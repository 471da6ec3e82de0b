"""The runtime's hand-written codec against the generated MAVLink classes, and the two against the interface page."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from runtime import codec
from sim_bridge.codec import Codec, read_command
from task.limits import DEFLECTION_LIMIT
from task.state import STATE

PAGE = Path(__file__).parents[2] / "docs" / "interface.md"

angle = st.floats(-1.4, 1.4)
finite = st.floats(-1e4, 1e4, width=32)


def read(data, origin=0.0):
    frame = codec.next_frame(bytearray(data), 0, len(data))
    assert frame is not None
    assert frame.message == codec.ODOMETRY
    assert codec.checksum_holds(bytearray(data), frame, codec.ODOMETRY_EXTRA)
    odometry = codec.Odometry()
    odometry.read(bytearray(data), frame, origin)
    return odometry


def odometry_message(**changes):
    fields = {
        "time_usec": 1_230_000,
        "frame_id": 1,
        "child_frame_id": 12,
        "x": 110.0,
        "y": -5.0,
        "z": 10.0,
        "q": [1.0, 0.0, 0.0, 0.0],
        "vx": 90.0,
        "vy": 0.5,
        "vz": 4.0,
        "rollspeed": 0.01,
        "pitchspeed": -0.02,
        "yawspeed": 0.03,
        "pose_covariance": [float("nan")] + [0.0] * 20,
        "velocity_covariance": [float("nan")] + [0.0] * 20,
        "reset_counter": 7,
        "estimator_type": 8,
        "quality": 100,
    }
    return mavlink.MAVLink_odometry_message(**(fields | changes))


def packed(message, system=1, component=200):
    return message.pack(mavlink.MAVLink(None, system, component))


def test_constants_are_the_dialect_s():
    for number, extra in (
        (codec.ODOMETRY, codec.ODOMETRY_EXTRA),
        (codec.HIL_ACTUATOR_CONTROLS, codec.HIL_ACTUATOR_CONTROLS_EXTRA),
    ):
        assert bytes([mavlink.mavlink_map[number].crc_extra]) == extra
    assert (codec.LOCAL_NED, codec.BODY_FRD) == (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD)
    assert codec.ARMED == mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert codec.LOCKSTEP == mavlink.HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.floats(-DEFLECTION_LIMIT, DEFLECTION_LIMIT), min_size=3, max_size=3),
    st.integers(0, 2**63),
    st.integers(0, 255),
    st.booleans(),
)
def test_controls_are_the_generated_ones_byte_for_byte(action, time_usec, sequence, lockstep):
    mav = mavlink.MAVLink(None, 1, 1)
    mav.seq = sequence
    controls = [a / DEFLECTION_LIMIT for a in action] + [0.0] * 13
    expected = mavlink.MAVLink_hil_actuator_controls_message(time_usec, controls, 128, int(lockstep)).pack(mav)
    assert bytes(codec.Controls(1, 1, lockstep).pack(sequence, time_usec, np.array(action))) == bytes(expected)


@settings(max_examples=200, deadline=None)
@given(st.lists(finite, min_size=9, max_size=9), st.integers(0, 2**63), st.integers(0, 255), st.integers(0, 100))
def test_odometry_is_read_as_the_generated_classes_read_it(values, time_usec, reset, quality):
    x, y, z, u, v, w, p, q, r = values
    data = packed(
        odometry_message(
            time_usec=time_usec, x=x, y=y, z=z, vx=u, vy=v, vz=w, rollspeed=p, pitchspeed=q, yawspeed=r,
            reset_counter=reset, quality=quality,
        )
    )  # fmt: skip
    theirs = mavlink.MAVLink(None).decode(bytearray(data))
    ours = read(data)
    assert (ours.time_usec, ours.reset_counter, ours.quality) == (theirs.time_usec, reset, quality)
    assert (ours.frame_id, ours.child_frame_id) == (1, 12)
    state = ours.x
    assert tuple(state[[STATE.p, STATE.q, STATE.r]]) == (theirs.rollspeed, theirs.pitchspeed, theirs.yawspeed)
    assert (state[STATE.xe], state[STATE.ye], state[STATE.h]) == (theirs.x, theirs.y, -theirs.z)
    speed = np.sqrt(theirs.vx**2 + theirs.vy**2 + theirs.vz**2)
    assert state[STATE.V] == pytest.approx(speed, rel=1e-12)
    np.testing.assert_allclose(state[STATE.V] * np.sin(state[STATE.beta]), theirs.vy, atol=1e-9 * (1 + speed))


def test_zeros_that_were_cut_off_are_put_back():
    data = packed(odometry_message(quality=0, estimator_type=0, reset_counter=0))
    assert len(data) < len(packed(odometry_message()))
    assert read(data).x[STATE.xe] == 110.0
    assert read(data).quality == 0


@settings(max_examples=200, deadline=None)
@given(angle, angle, st.floats(-3.1, 3.1), angle, angle, st.floats(1.0, 300.0))
def test_a_state_survives_the_way_from_the_bridge(phi, theta, psi, alpha, beta, V):
    x = np.array([0.1, -0.2, 0.3, V, alpha, beta, phi, theta, psi, 1990.0, 110.0, -5.0])
    odometry = read(Codec(2000.0, 3).odometry(10_000, x), 2000.0)
    np.testing.assert_allclose(odometry.x, x, atol=2e-5 * max(1.0, 1.0 / np.cos(theta)), rtol=1e-6)
    assert (odometry.time_usec, odometry.reset_counter) == (10_000, 3)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-DEFLECTION_LIMIT, DEFLECTION_LIMIT), min_size=3, max_size=3))
def test_a_command_survives_the_way_to_the_bridge(action):
    frame = codec.Controls(1, 1, True).pack(9, 1_230_000, np.array(action))
    command = read_command(mavlink.MAVLink(None).decode(bytearray(frame)))
    assert command.time_us == 1_230_000
    assert command.refusal == ""
    np.testing.assert_allclose(command.action, action, atol=1e-8)


def test_a_frame_from_another_dialect_or_damaged_does_not_pass():
    data = bytearray(packed(odometry_message()))
    frame = codec.next_frame(data, 0, len(data))
    assert not codec.checksum_holds(data, frame, b"\x00")
    for position in (5, 20, 100, len(data) - 1):
        bad = bytearray(data)
        bad[position] ^= 0x10
        assert not codec.checksum_holds(bad, frame, codec.ODOMETRY_EXTRA)


@settings(max_examples=500, deadline=None)
@given(st.binary(max_size=300))
def test_no_bytes_can_make_the_reader_fail(data):
    buffer = bytearray(data)
    frame = codec.next_frame(buffer, 0, len(buffer))
    if frame is not None:
        assert frame.end <= len(buffer)
        codec.checksum_holds(buffer, frame, codec.ODOMETRY_EXTRA)


@settings(max_examples=300, deadline=None)
@given(st.binary(min_size=233, max_size=233))
def test_no_payload_can_make_the_state_fail(payload):
    buffer = bytearray(b"\xfd\xe9\x00\x00\x00\x01\x01\x4b\x01\x00" + payload + b"\x00\x00")
    odometry = codec.Odometry()
    odometry.read(buffer, codec.next_frame(buffer, 0, len(buffer)), 0.0)
    assert odometry.x.shape == (12,)


def test_signed_and_unknown_frames_are_framed_or_refused():
    data = bytearray(packed(odometry_message()))
    data[2] = 0x01
    assert codec.next_frame(data, 0, len(data)) is None
    signed = data + bytes(13)
    assert codec.next_frame(signed, 0, len(signed)).end == len(signed)
    data[2] = 0x02
    assert codec.next_frame(data, 0, len(data)) is None


def example(heading):
    """Return the bytes of an example of the interface page."""
    text = PAGE.read_text().split(heading, 1)[1].split("```")[1]
    data = bytearray()
    for line in text.strip().splitlines():
        bytes_only = re.split(r"\s{3,}", line)[0]
        for run, count in re.findall(r"((?:\b[0-9a-f]{2}\b ?)+)|\((\d+) times 00\)", bytes_only):
            data += bytes.fromhex(run) if run else bytes(int(count))
    return bytes(data)


def test_the_pages_examples_are_what_both_sides_speak():
    state = example("An example, byte for byte")
    assert len(state) == 245
    odometry = read(state, 2000.0)
    expected = [0.01, -0.02, 0.03, 90.0, 0.05, 0.01, 0.1, 0.02, -0.3, 1990.0, 110.0, -5.0]
    np.testing.assert_allclose(odometry.x, expected, atol=1e-6, rtol=1e-6)
    assert (odometry.time_usec, odometry.reset_counter) == (1_230_000, 7)
    action = np.radians([-2.0, 1.0, 0.0])
    reply = example("The reply elevator")
    assert len(reply) == 93
    assert bytes(codec.Controls(1, 1, True).pack(0, 1_230_000, action)) == reply
