"""The link over real UDP sockets, against the bridge's codec and the generated classes."""

import contextlib
import re
import socket
import time

import numpy as np
import pytest
from pymavlink.dialects.v10 import common as mavlink1
from pymavlink.dialects.v20 import common as mavlink

from runtime.mavlink_link import MavlinkLink
from runtime.udp import parse_address
from sim_bridge.codec import Codec, Status, read_command
from task.errors import UserError
from task.state import STATE

LEVEL = np.zeros(12)
LEVEL[STATE.V], LEVEL[STATE.h], LEVEL[STATE.theta], LEVEL[STATE.alpha] = 90.0, 2000.0, 0.05, 0.05


class Aircraft:
    """The other end: a socket and the bridge's codec."""

    def __init__(self, port, reset_counter=1):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(1.0)
        self.codec = Codec(2000.0, reset_counter)
        self.mav = mavlink.MAVLink(None)

    def send(self, *frames):
        for frame in frames:
            self.socket.send(frame)

    def state(self, time_us, x=LEVEL):
        self.send(self.codec.origin(time_us), self.codec.odometry(time_us, x))

    def receive(self, kind):
        """Return the next message of a kind."""
        while True:
            message = self.mav.decode(bytearray(self.socket.recv(4096)))
            if message.get_type() == kind:
                return message

    def silent(self, kind, seconds=0.1):
        self.socket.settimeout(seconds)
        try:
            self.receive(kind)
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(1.0)
        return False


@pytest.fixture
def make():
    made = []

    def make_(lockstep=True, **options):
        probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        link = MavlinkLink(parse_address(f"udpin:127.0.0.1:{port}"), lockstep, **options)
        made.append(link)
        return link, port

    yield make_
    for link in made:
        link.close()


@pytest.fixture
def pair(make):
    lines = []
    link, port = make(say_here=lines.append)
    aircraft = Aircraft(port)
    yield link, aircraft, lines
    aircraft.socket.close()


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("14560", "expected udpin:HOST:PORT or udpout:HOST:PORT"),
        ("tcp:127.0.0.1:14560", "expected udpin:HOST:PORT or udpout:HOST:PORT"),
        ("udpin:127.0.0.1:port", "expected a port from 1 to 65535, got 'port'"),
        ("udpin:127.0.0.1:70000", "expected a port from 1 to 65535, got '70000'"),
    ],
)
def test_a_bad_address_is_one_line(text, line):
    with pytest.raises(UserError, match=line):
        parse_address(text)


@pytest.mark.parametrize("kind", ["udpin", "udpout"])
@pytest.mark.parametrize("host", ["no.such.host.invalid", "ü..x", "a" * 70])
def test_a_host_that_nobody_knows_is_one_line_at_the_start(kind, host):
    with pytest.raises(UserError, match=f"--link {kind}:{host}:14560: cannot resolve {host}: .*; check the address"):
        MavlinkLink(parse_address(f"{kind}:{host}:14560"), True)


def test_a_port_in_use_and_a_foreign_host_are_one_line(make):
    _, port = make()
    with pytest.raises(UserError, match=f"port {port} is in use"):
        MavlinkLink(parse_address(f"udpin:127.0.0.1:{port}"), True)
    with pytest.raises(UserError, match="cannot listen there"):
        MavlinkLink(parse_address("udpin:192.0.2.1:14560"), True)


def test_a_state_is_read_and_its_answer_echoes_it(pair):
    link, aircraft, _ = pair
    x = LEVEL.copy()
    x[STATE.phi], x[STATE.q] = -0.3, 0.02
    aircraft.state(1_230_000, x)
    sample = link.read(1.0)
    assert (sample.time_usec, sample.flight) == (1_230_000, 1)
    np.testing.assert_allclose(sample.x, x, atol=1e-6)
    link.write(np.array([-0.03, 0.01, 0.0]), sample.time_usec)
    reply = aircraft.receive("HIL_ACTUATOR_CONTROLS")
    assert (reply.time_usec, reply.mode, reply.flags) == (1_230_000, 128, 1)
    np.testing.assert_allclose(read_command(reply).action, [-0.03, 0.01, 0.0], atol=1e-8)


def test_a_state_sent_again_is_answered_again_without_a_cycle(pair):
    link, aircraft, _ = pair
    aircraft.state(10_000)
    link.write(np.array([-0.03, 0.01, 0.0]), link.read(1.0).time_usec)
    first = aircraft.receive("HIL_ACTUATOR_CONTROLS")
    aircraft.state(10_000)
    assert link.read(0.05) is None
    again = aircraft.receive("HIL_ACTUATOR_CONTROLS")
    assert (again.time_usec, again.controls) == (first.time_usec, first.controls)
    assert link.repeated == 1
    aircraft.state(20_000)
    assert link.read(1.0).time_usec == 20_000


def test_a_state_that_was_not_answered_is_handed_over_again(pair):
    link, aircraft, _ = pair
    for _ in range(2):
        aircraft.state(10_000)
        assert link.read(1.0).time_usec == 10_000


def test_it_answers_nobody_before_it_knows_the_origin(pair):
    link, aircraft, lines = pair
    aircraft.send(aircraft.codec.odometry(0, LEVEL))
    assert link.read(0.05) is None
    assert "GPS_GLOBAL_ORIGIN" in link.diagnosis()
    assert len(lines) == 1
    aircraft.state(0)
    assert link.read(1.0).x[STATE.h] == pytest.approx(2000.0)


def test_it_says_who_it_is_once_a_second(pair):
    link, aircraft, _ = pair
    aircraft.state(0)
    link.read(1.0)
    start, beats = time.monotonic(), []
    while len(beats) < 2 and time.monotonic() - start < 4.0:
        link.read(0.1)
        aircraft.socket.settimeout(0.001)
        with contextlib.suppress(TimeoutError):
            beats.append(aircraft.receive("HEARTBEAT"))
    assert len(beats) == 2
    assert time.monotonic() - start > 0.9
    beat = beats[0]
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 1)
    assert (beat.type, beat.autopilot) == (mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_GENERIC)


@pytest.mark.parametrize(("status", "ended"), [(Status.OVER, "over"), (Status.AIRCRAFT_LOST, "lost")])
def test_the_aircraft_ends_the_flight_and_nobody_else(pair, status, ended):
    link, aircraft, _ = pair
    aircraft.send(aircraft.codec.heartbeat(status, True))
    assert link.read(0.05) is None
    assert link.ended == ""
    aircraft.state(0)
    link.read(1.0)
    stranger = mavlink.MAVLink_heartbeat_message(1, 0, 0, 0, status, 3).pack(mavlink.MAVLink(None, 42, 1))
    aircraft.send(aircraft.codec.heartbeat(Status.FLYING, True), stranger)
    assert link.read(0.05) is None
    assert link.ended == ""
    aircraft.send(aircraft.codec.heartbeat(status, True))
    assert link.read(1.0) is None
    assert link.ended == ended


def odometry(**changes):
    fields = {
        "time_usec": 0, "frame_id": 1, "child_frame_id": 12, "x": 0.0, "y": 0.0, "z": 0.0, "q": [1.0, 0.0, 0.0, 0.0],
        "vx": 90.0, "vy": 0.0, "vz": 4.0, "rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.0,
        "pose_covariance": [0.0] * 21, "velocity_covariance": [0.0] * 21, "reset_counter": 1, "estimator_type": 8,
        "quality": 100,
    }  # fmt: skip
    return mavlink.MAVLink_odometry_message(**(fields | changes))


def damaged_dialect():
    message = odometry()
    message.crc_extra = 1
    return bytes(message.pack(mavlink.MAVLink(None, 1, 200)))


@pytest.mark.parametrize(
    ("frame", "line"),
    [
        (lambda: mavlink1.MAVLink_heartbeat_message(1, 0, 0, 0, 4, 3).pack(mavlink1.MAVLink(None)), "MAVLink 1"),
        (damaged_dialect, "wrong checksum: damaged, or another MAVLink dialect"),
        (lambda: b"hello there, is this a socket?", "no MAVLink 2 frame"),
        (lambda: bytes(odometry().pack(mavlink.MAVLink(None)))[:40], "damaged frame"),
        (lambda: odometry(frame_id=0, child_frame_id=8).pack(mavlink.MAVLink(None)),
         r"frames 0, 8: expected 1 \(MAV_FRAME_LOCAL_NED\), 12 \(MAV_FRAME_BODY_FRD\)"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_said_once_and_named_at_the_end(pair, frame, line):
    link, aircraft, lines = pair
    aircraft.send(aircraft.codec.origin(0))
    for _ in range(5):
        aircraft.send(frame())
    assert link.read(0.05) is None
    assert len(lines) == 1
    assert re.search(line, lines[0])
    assert "5 x " in link.diagnosis()
    aircraft.state(0)
    assert link.read(1.0) is not None


def test_another_program_is_named_by_what_it_sends(pair):
    link, aircraft, _ = pair
    mav = mavlink.MAVLink(None, 1, 1)
    aircraft.send(*[mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(mav) for _ in range(3)])
    assert link.read(0.05) is None
    assert "heard only 3 x ATTITUDE" in link.diagnosis()


def test_silence_is_named(make):
    link, _ = make()
    assert link.read(0.01) is None
    assert "nothing came at all" in link.diagnosis()


def test_a_flood_is_dropped_and_said(make):
    lines = []
    link, port = make(say_here=lines.append)
    link.FLOOD = 100
    aircraft = Aircraft(port)
    aircraft.state(0)
    link.read(1.0)
    frame = mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(mavlink.MAVLink(None))
    end = time.monotonic() + 2.5
    while time.monotonic() < end and not lines:
        aircraft.send(*[frame] * 20)
        start = time.monotonic()
        assert link.read(0.01) is None
        assert time.monotonic() - start < 0.2
    assert "messages of no use in a second, mostly ATTITUDE" in lines[0]
    aircraft.state(10_000)
    assert link.read(1.0).time_usec == 10_000
    aircraft.socket.close()


def test_a_second_aircraft_is_not_heard_while_the_first_one_speaks(pair, make):
    link, aircraft, lines = pair
    other = Aircraft(link.address.peer[1], reset_counter=9)
    aircraft.state(0)
    assert link.read(1.0).flight == 1
    other.state(0)
    assert link.read(0.05) is None
    assert "second aircraft" in lines[-1]
    link.PEER_SILENCE = 0.05
    time.sleep(0.1)
    other.state(0)
    assert link.read(1.0).flight == 9
    other.socket.close()


def origin(altitude, system=42, component=1):
    message = mavlink.MAVLink_gps_global_origin_message(0, 0, round(1e3 * altitude), 0)
    return message.pack(mavlink.MAVLink(None, system, component))


def test_another_ones_origin_is_not_the_aircrafts(pair):
    link, aircraft, lines = pair
    other = Aircraft(link.address.peer[1])
    other.send(origin(9000.0))
    aircraft.send(aircraft.codec.odometry(0, LEVEL))
    assert link.read(0.05) is None  # nobody knows its origin yet
    aircraft.state(0)
    assert link.read(1.0).x[STATE.h] == pytest.approx(2000.0)
    other.send(origin(9000.0), origin(9000.0, 1, 200))  # a stranger, and one that says it were the aircraft
    aircraft.send(origin(9000.0))  # another system behind the aircraft's own address
    aircraft.send(aircraft.codec.odometry(10_000, LEVEL))
    assert link.read(1.0).x[STATE.h] == pytest.approx(2000.0)
    assert sum("GPS_GLOBAL_ORIGIN" in line and "is not the aircraft's" in line for line in lines) == 3
    other.socket.close()


def test_an_aircraft_that_takes_anothers_place_brings_its_own_origin(pair):
    link, aircraft, _ = pair
    aircraft.state(0)
    assert link.read(1.0) is not None
    link.PEER_SILENCE = 0.05
    other = Aircraft(link.address.peer[1], reset_counter=9)
    other.codec = Codec(3000.0, 9)
    other.send(other.codec.origin(0))
    assert link.read(0.1) is None
    high = LEVEL.copy()
    high[STATE.h] = 3100.0
    other.send(other.codec.odometry(0, high))
    sample = link.read(1.0)
    assert (sample.flight, sample.x[STATE.h]) == (9, pytest.approx(3100.0))
    other.socket.close()


def test_a_flood_of_origins_does_not_wash_the_aircrafts_away(pair):
    link, aircraft, _ = pair
    aircraft.state(0)
    assert link.read(1.0) is not None
    for system in range(2, 60):
        aircraft.send(origin(9000.0, system))
        link.read(0.0)
    assert len(link._origins) == link.SENDERS
    aircraft.send(aircraft.codec.odometry(10_000, LEVEL))
    assert link.read(1.0).x[STATE.h] == pytest.approx(2000.0)


@pytest.mark.parametrize("lockstep", [True, False])
def test_states_that_share_a_datagram_are_counted(make, lockstep):
    link, port = make(lockstep=lockstep)
    aircraft = Aircraft(port)
    states = [aircraft.codec.odometry(10_000 * k, LEVEL) for k in range(3)]
    aircraft.send(b"".join([aircraft.codec.origin(0), *states]))
    assert link.read(1.0).time_usec == 20_000
    assert link.skipped == 2
    aircraft.send(aircraft.codec.odometry(30_000, LEVEL))
    assert link.read(1.0).time_usec == 30_000
    assert (link.skipped, link.repeated) == (2, 0)
    aircraft.socket.close()


def test_in_real_time_the_newest_state_counts(make):
    link, port = make(lockstep=False)
    aircraft = Aircraft(port)
    for k in range(3):
        aircraft.state(10_000 * k)
    time.sleep(0.05)
    assert link.read(1.0).time_usec == 20_000
    assert link.skipped == 2
    aircraft.state(10_000)
    assert link.read(0.05) is None
    assert link.refused["ODOMETRY out of order"] == 1
    aircraft.socket.close()


def set_attitude(q, type_mask=7, system=1):
    message = mavlink.MAVLink_set_attitude_target_message(5, system, 1, type_mask, q, 0.0, 0.0, 0.0, 0.0)
    return message.pack(mavlink.MAVLink(None, 255, 190))


def test_set_points_come_over_the_link_and_are_said_back(make):
    heard, lines = [], []
    link, port = make(on_setpoint=lambda theta, phi: heard.append((theta, phi)), say_here=lines.append)
    ground = Aircraft(port)
    roll = [np.cos(0.1), np.sin(0.1), 0.0, 0.0]
    ground.send(set_attitude(roll))
    assert link.read(0.05) is None
    np.testing.assert_allclose(heard, [(0.0, 0.2)], atol=1e-6)
    back = ground.receive("ATTITUDE_TARGET")
    np.testing.assert_allclose(back.q, roll, atol=1e-6)
    ground.send(set_attitude(roll, type_mask=128), set_attitude([0.0] * 4), set_attitude([np.nan] * 4))
    assert link.read(0.05) is None
    assert len(heard) == 1
    assert len(lines) == 2
    ground.socket.close()


def test_set_points_are_said_to_be_ignored_with_a_file(pair):
    link, aircraft, lines = pair
    aircraft.send(set_attitude([1.0, 0.0, 0.0, 0.0]))
    link.read(0.05)
    assert lines == ["link: SET_ATTITUDE_TARGET ignored: the reference comes from a file"]


def test_a_line_reaches_the_ground_in_chunks(pair):
    link, aircraft, _ = pair
    aircraft.state(0)
    link.read(1.0)
    link.say("short", 6)
    assert aircraft.receive("STATUSTEXT").text == "short"
    link.say("x" * 120, 4)
    parts = [aircraft.receive("STATUSTEXT") for _ in range(3)]
    assert "".join(p.text for p in parts) == "x" * 120
    assert [p.chunk_seq for p in parts] == [0, 1, 2]
    assert len({p.id for p in parts}) == 1
    assert parts[0].id != 0


def test_it_can_speak_first():
    aircraft = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    aircraft.bind(("127.0.0.1", 0))
    aircraft.settimeout(1.0)
    link = MavlinkLink(parse_address(f"udpout:127.0.0.1:{aircraft.getsockname()[1]}"), True)
    link.read(0.01)
    frame, runtime = aircraft.recvfrom(4096)
    assert mavlink.MAVLink(None).decode(bytearray(frame)).get_type() == "HEARTBEAT"
    codec = Codec(2000.0, 1)
    for frame in (codec.origin(0), codec.odometry(0, LEVEL)):
        aircraft.sendto(frame, runtime)
    assert link.read(1.0).time_usec == 0
    link.close()
    aircraft.close()


def test_no_datagram_can_end_the_link(pair):
    link, aircraft, _ = pair
    rng = np.random.default_rng(0)
    frame = bytearray(aircraft.codec.odometry(0, LEVEL))
    for _ in range(200):
        bad = bytearray(frame)
        for position in rng.integers(0, len(bad), 3):
            bad[position] = rng.integers(0, 256)
        aircraft.send(bytes(bad[: rng.integers(1, len(bad) + 1)]), rng.bytes(int(rng.integers(1, 100))))
        link.read(0.0)
    aircraft.state(0)
    assert link.read(1.0) is not None
    assert len(link.refused) <= link.LINES + 1
