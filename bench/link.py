"""What one round trip over the link costs: state out, command back, two processes on UDP loopback.

``python bench/link.py`` measures all variants in turns within one run, so that their ratios mean something on a
noisy machine, and writes ``results/link.json``.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import socket
import struct
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import NamedTuple

import click
import numpy as np

from runtime import codec as by_hand
from sim_bridge.codec import Codec, read_command
from task.limits import DEFLECTION_LIMIT
from task.results import Claim, Result, Table, write
from task.state import STATE
from understudy import run

BUFFER = 4096
ORIGIN = 2000.0
BARE_STATE = struct.Struct("<Q13f")
BARE_COMMAND = struct.Struct("<Q3f")
PATIENCE = 5.0
ACTION = np.array([-0.024, 0.001, 0.002])


class Variant(NamedTuple):
    """One way to speak over the link."""

    name: str
    trip: Callable[[socket.socket], Callable[[int], int]]
    """Makes, on the aircraft's side, a function that sends the state of a time and returns the reply's echo."""
    serve: Callable[[socket.socket], None]
    """Answers for ever, on the runtime's side."""


def state() -> np.ndarray:
    """Return a state with numbers of the usual size."""
    x = np.full(len(STATE), 0.05)
    x[STATE.V], x[STATE.h], x[STATE.xe] = 90.0, 1990.0, 110.0
    return x


def bare_trip(link: socket.socket) -> Callable[[int], int]:
    """Pack the numbers alone: no frame, no checksum, no conversion."""
    x = state().tolist()

    def trip(time_us: int) -> int:
        link.send(BARE_STATE.pack(time_us, *x, 0.0))
        return BARE_COMMAND.unpack(link.recv(BUFFER))[0]

    return trip


def bare_serve(link: socket.socket) -> None:
    """Answer bare numbers with bare numbers."""
    action = ACTION.tolist()
    while True:
        data, peer = link.recvfrom(BUFFER)
        link.sendto(BARE_COMMAND.pack(BARE_STATE.unpack(data)[0], *action), peer)


def bridge_trip(link: socket.socket) -> Callable[[int], int]:
    """Speak as the bridge does."""
    codec, x = Codec(ORIGIN, 0), state()

    def trip(time_us: int) -> int:
        link.send(codec.odometry(time_us, x))
        return max(read_command(message).time_us for message in codec.messages(link.recv(BUFFER)))

    return trip


def bridge_serve(link: socket.socket) -> None:
    """Answer through pymavlink's classes too: what the runtime would cost with the bridge's way."""
    from pymavlink.dialects.v20 import common as mavlink

    mav = mavlink.MAVLink(None, 1, 1)
    while True:
        data, peer = link.recvfrom(BUFFER)
        message = mav.decode(bytearray(data))
        controls = [a / DEFLECTION_LIMIT for a in ACTION] + [0.0] * 13
        reply = mavlink.MAVLink_hil_actuator_controls_message(message.time_usec, controls, 128, 1)
        link.sendto(reply.pack(mav), peer)


def runtime_serve(link: socket.socket) -> None:
    """Answer with the runtime's codec."""
    odometry, controls = by_hand.Odometry(), by_hand.Controls(1, 1, lockstep=True)
    while True:
        received, peer = link.recvfrom(BUFFER)
        data = bytearray(received)
        frame = by_hand.next_frame(data, 0, len(data))
        if frame is None or not by_hand.checksum_holds(data, frame, by_hand.ODOMETRY_EXTRA):
            continue
        odometry.read(data, frame, ORIGIN)
        link.sendto(controls.pack(0, odometry.time_usec, ACTION), peer)


def mavutil_trip(link: socket.socket) -> Callable[[int], int]:
    """Speak through mavutil, as most scripts do."""
    mavutil = import_mavutil()
    host, port = link.getpeername()
    connection = mavutil.mavlink_connection(f"udpout:{host}:{port}", source_system=1, source_component=200)
    unknown = [math.nan] + [0.0] * 20

    def trip(time_us: int) -> int:
        connection.mav.odometry_send(
            time_us, 1, 12, 110.0, 0.05, 10.0, (1.0, 0.0, 0.0, 0.0), 89.9, 4.5, 4.5, 0.05, 0.05, 0.05,
            unknown, unknown, 0, 8, 100,
        )  # fmt: skip
        reply = connection.recv_match(type="HIL_ACTUATOR_CONTROLS", blocking=True, timeout=PATIENCE)
        return reply.time_usec if reply is not None else -1

    return trip


def mavutil_serve(link: socket.socket) -> None:
    """Answer through mavutil."""
    mavutil = import_mavutil()
    port = link.getsockname()[1]
    link.close()
    connection = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=1, source_component=1)
    while True:
        message = connection.recv_match(type="ODOMETRY", blocking=True)
        controls = [a / DEFLECTION_LIMIT for a in ACTION] + [0.0] * 13
        connection.mav.hil_actuator_controls_send(message.time_usec, controls, 128, 1)


def import_mavutil():
    """Return mavutil, told to speak MAVLink 2: without that it cannot carry ODOMETRY."""
    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavutil

    return mavutil


VARIANTS = (
    Variant("bare struct", bare_trip, bare_serve),
    Variant("bridge and runtime", bridge_trip, runtime_serve),
    Variant("pymavlink classes on both sides", bridge_trip, bridge_serve),
    Variant("mavutil on both sides", mavutil_trip, mavutil_serve),
)
"""The first is the physical limit that the others are compared with."""


def serve(index: int, pipe: Connection) -> None:
    """Child process: bind, say the port, answer."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", 0))
    pipe.send(link.getsockname()[1])
    VARIANTS[index].serve(link)


def connect(port: int) -> socket.socket:
    """Return a socket connected to a child."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.connect(("127.0.0.1", port))
    link.settimeout(PATIENCE)
    return link


def measure(rounds: int, trips: int) -> list[np.ndarray]:
    """Return the round trips of each variant [us], taken in turns."""
    context = multiprocessing.get_context("spawn")
    ports, children = [], []
    for index in range(len(VARIANTS)):
        here, there = context.Pipe()
        child = context.Process(target=serve, args=(index, there), daemon=True)
        child.start()
        children.append(child)
        ports.append(here.recv())
    time.sleep(1.0)  # mavutil binds the port again, after its import
    makers = [variant.trip(connect(port)) for variant, port in zip(VARIANTS, ports, strict=True)]
    samples: list[list[float]] = [[] for _ in VARIANTS]
    for turn in range(rounds + 1):
        for trip, kept in zip(makers, samples, strict=True):
            for n in range(trips):
                began = time.perf_counter()
                echo = trip(n)
                took = time.perf_counter() - began
                if echo != n:
                    raise RuntimeError(f"asked for {n}, answered {echo}")
                if turn:  # the first turn warms up
                    kept.append(1e6 * took)
    for child in children:
        child.terminate()
        child.join()
    return [np.array(kept) for kept in samples]


@click.command()
@click.option("--rounds", type=click.IntRange(1), default=10, show_default=True)
@click.option(
    "--trips", type=click.IntRange(1), default=1000, show_default=True, help="Round trips of each variant in a round."
)
def main(rounds: int, trips: int) -> None:
    """Measure and write results/link.json."""
    began = time.perf_counter()
    samples = measure(rounds, trips)
    medians = [float(np.median(s)) for s in samples]
    rows: list[list] = [
        [v.name, round(m, 1), round(float(np.quantile(s, 0.99)), 1), round(m / medians[0], 2)]
        for v, s, m in zip(VARIANTS, samples, medians, strict=True)
    ]
    ours, mavutil = medians[1] / medians[0], medians[3] / medians[1]
    result = Result(
        title="One round trip over the link: a state out, a command back",
        command="python bench/link.py",
        seconds=round(time.perf_counter() - began, 1),
        runs=rounds * trips,
        seeds=[],
        claims=[
            Claim(claim="bridge and runtime against bare struct", value=round(ours, 2), unit="times as long"),
            Claim(
                claim="mavutil against bridge and runtime", value=round(mavutil, 2), unit="times as long",
                target="> 1", holds=mavutil > 1.0,
            ),
        ],
        tables=[Table(title="Round trip", columns=["variant", "median [us]", "p99 [us]", "ratio"], rows=rows)],
        notes=["UDP loopback, two processes, variants in turns within one run; compare the ratios, not the times."],
    )  # fmt: skip
    print(write("link", result))
    for row in rows:
        print(f"{row[0]:34} median {row[1]:8.1f} us   p99 {row[2]:8.1f} us   x{row[3]:.2f}")


if __name__ == "__main__":
    run(main)
