"""The bridge's codec against struct, against its own inverse, and against the page that describes it."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sim_bridge.codec import Codec, Status, body_velocity, quaternion, read_command, require_fast_checksums
from task.limits import DEFLECTION_LIMIT
from task.state import STATE

PAGE = Path(__file__).parents[2] / "docs" / "interface.md"


def example_state() -> np.ndarray:
    x = np.zeros(len(STATE))
    x[[STATE.p, STATE.q, STATE.r]] = 0.01, -0.02, 0.03
    x[[STATE.V, STATE.alpha, STATE.beta]] = 90.0, 0.05, 0.01
    x[[STATE.phi, STATE.theta, STATE.psi]] = 0.1, 0.02, -0.3
    x[[STATE.h, STATE.xe, STATE.ye]] = 1990.0, 110.0, -5.0
    return x


def bytes_on_page(heading: str) -> bytes:
    """Return the bytes of the code block that follows a phrase of the page."""
    block = PAGE.read_text().split(heading, 1)[1].split("```")[1]
    data = b""
    for line in filter(None, block.splitlines()):
        left = re.split(r" {3,}", line)[0]
        zeros = re.search(r"\((\d+) times 00\)", left)
        data += bytes.fromhex(re.sub(r"\(.*\)", "", left)) + bytes(int(zeros[1]) if zeros else 0)
    return data


def one(codec: Codec, frame: bytes) -> mavlink.MAVLink_message:
    (message,) = codec.messages(frame)
    return message


def state_of(message: mavlink.MAVLink_message, origin_altitude: float) -> np.ndarray:
    """Read a state back as docs/interface.md tells a runtime to."""
    u, v, w = message.vx, message.vy, message.vz
    qw, qx, qy, qz = message.q
    V = math.sqrt(u * u + v * v + w * w)
    x = np.zeros(len(STATE))
    x[[STATE.p, STATE.q, STATE.r]] = message.rollspeed, message.pitchspeed, message.yawspeed
    x[[STATE.V, STATE.alpha, STATE.beta]] = V, math.atan2(w, u), math.asin(v / V)
    x[STATE.phi] = math.atan2(2 * (qw * qx + qy * qz), 1 - 2 * (qx * qx + qy * qy))
    x[STATE.theta] = math.asin(max(-1.0, min(1.0, 2 * (qw * qy - qz * qx))))
    x[STATE.psi] = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    x[[STATE.h, STATE.xe, STATE.ye]] = origin_altitude - message.z, message.x, message.y
    return x


def test_odometry_is_the_example_on_the_page_byte_for_byte():
    assert Codec(2000.0, 7).odometry(1_230_000, example_state()) == bytes_on_page("from system 1, component 200")


def test_the_reply_on_the_page_is_read_as_the_page_says(frame_of):
    frame = bytes_on_page("from system 1, component 1:")
    assert frame == frame_of(1_230_000, [-0.2, 0.1, 0.0])
    command = read_command(one(Codec(0.0, 0), frame))
    assert command.time_us == 1_230_000
    np.testing.assert_allclose(np.degrees(command.action), [-2.0, 1.0, 0.0], atol=1e-6)


def test_odometry_layout_is_that_of_the_page_read_with_struct():
    frame = Codec(2000.0, 7).odometry(5, example_state())
    fields = struct.unpack("<Q13f42fBBBBb", frame[10:-2])
    assert fields[0] == 5
    assert fields[1:4] == (110.0, -5.0, 10.0)
    assert fields[11:14] == pytest.approx((0.01, -0.02, 0.03))
    assert math.isnan(fields[14])
    assert math.isnan(fields[35])
    assert fields[56:] == (1, 12, 7, 8, 100)


@given(
    rates=st.tuples(*[st.floats(-2, 2)] * 3),
    V=st.floats(60, 200),
    angles=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    attitude=st.tuples(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-3.1, 3.1)),
    position=st.tuples(st.floats(0, 12000), st.floats(-2e4, 2e4), st.floats(-2e4, 2e4)),
)
def test_a_state_survives_the_link_to_float32(rates, V, angles, attitude, position):
    x = np.array([*rates, V, *angles, *attitude, *position])
    back = state_of(one(Codec(2000.0, 0), Codec(2000.0, 0).odometry(0, x)), 2000.0)
    scale = np.array([1, 1, 1, 100, 1, 1, 1, 10, 1, 1e4, 1e4, 1e4])
    error = np.abs(back - x) / scale
    error[STATE.psi] = abs(math.remainder(back[STATE.psi] - x[STATE.psi], 2 * math.pi))
    assert error.max() < 1e-6


def test_body_velocity_and_quaternion_by_hand():
    assert body_velocity(100.0, 0.0, math.pi / 6) == pytest.approx((86.602540, 50.0, 0.0))
    assert body_velocity(100.0, math.pi / 6, 0.0) == pytest.approx((86.602540, 0.0, 50.0))
    half = math.sqrt(0.5)
    assert quaternion(math.pi / 2, 0, 0) == pytest.approx((half, half, 0, 0))
    assert quaternion(0, math.pi / 2, 0) == pytest.approx((half, 0, half, 0))
    assert quaternion(0, 0, math.pi / 2) == pytest.approx((half, 0, 0, half))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_a_state_that_is_not_finite_goes_out_as_nan_and_never_raises(value):
    for name in STATE:
        x = example_state()
        x[name] = value
        frame = Codec(2000.0, 0).odometry(0, x)
        sent = struct.unpack("<13f", frame[18:70])
        assert any(map(math.isnan, sent)), name
        assert not any(map(math.isinf, sent)), name


def test_wind_origin_and_heartbeat_carry_their_fields():
    codec = Codec(2000.123, 0)
    wind = one(codec, codec.wind(20_000, np.array([1.0, -2.0, 0.5]), 1990.0))
    assert (wind.time_usec, wind.wind_x, wind.wind_y, wind.wind_z, wind.wind_alt) == (20_000, 1.0, -2.0, 0.5, 1990.0)
    origin = one(codec, codec.origin(20_000))
    assert (origin.altitude, origin.time_usec) == (2_000_123, 20_000)
    heartbeat = one(codec, codec.heartbeat(Status.FLYING, lockstep=True))
    assert (heartbeat.system_status, heartbeat.custom_mode, heartbeat.get_srcComponent()) == (4, 1, 200)


def test_the_sequence_number_counts_every_frame():
    codec = Codec(0.0, 0)
    frames = [codec.heartbeat(4, True) for _ in range(300)]
    assert [f[4] for f in frames] == [n % 256 for n in range(300)]


@pytest.mark.parametrize(
    ("controls", "mode", "refusal"),
    [
        ([math.nan, 0, 0], 128, "not finite"),
        ([0, math.inf, 0], 128, "not finite"),
        ([0, 0, 1.0001], 128, "out of range"),
        ([-1.0001, 0, 0], 128, "out of range"),
        ([0, 0, 0], 0, "not armed"),
    ],
)
def test_a_bad_command_is_refused_with_its_reason(frame_of, controls, mode, refusal):
    command = read_command(one(Codec(0.0, 0), frame_of(10_000, controls, mode)))
    assert command.action is None
    assert (command.time_us, command.refusal) == (10_000, refusal)


def test_full_deflection_is_ten_degrees_and_allowed(frame_of):
    command = read_command(one(Codec(0.0, 0), frame_of(0, [1.0, -1.0, 0.5])))
    np.testing.assert_allclose(command.action, np.array([1.0, -1.0, 0.5]) * DEFLECTION_LIMIT)


def test_several_frames_in_a_datagram_are_all_read_and_rubbish_is_told(frame_of):
    codec = Codec(0.0, 0)
    good = frame_of(0, [0, 0, 0])
    broken = good[:-1] + bytes([good[-1] ^ 1])
    first, second, third, fourth = codec.messages(good + broken + good + good[:20])
    assert (first.get_msgId(), third.get_msgId()) == (93, 93)
    assert "CRC" in second
    assert fourth == "20 bytes that are no MAVLink frame"


@given(st.binary(max_size=400))
def test_no_bytes_whatever_make_the_codec_raise(data):
    codec = Codec(0.0, 0)
    for prefix in (b"", b"\xfd", b"\xfe"):
        for message in codec.messages(prefix + data):
            assert isinstance(message, (str, mavlink.MAVLink_message))


def test_checksums_are_the_fast_ones():
    require_fast_checksums()
