"""A scripted runtime for the bridge's tests: its own thread, its own socket, its own codec (struct)."""

from __future__ import annotations

import math
import socket
import struct
import threading
from collections.abc import Callable, Iterator

import fastcrc
import pytest

ODOMETRY_ID, ODOMETRY_EXTRA = 331, 91
CONTROLS_ID, CONTROLS_EXTRA = 93, 47

Script = Callable[["Peer", int], "list[bytes]"]


def checksum(frame: bytes, extra: int) -> bytes:
    return struct.pack("<H", fastcrc.crc16.mcrf4xx(frame[1:] + bytes([extra])))


def controls_frame(time_us: int, controls: list[float], mode: int = 128, sequence: int = 0) -> bytes:
    """Return a HIL_ACTUATOR_CONTROLS made by hand."""
    payload = struct.pack("<QQ16fB", time_us, 1, *controls, *[0.0] * (16 - len(controls)), mode)
    frame = struct.pack("<BBBBBBBHB", 0xFD, len(payload), 0, 0, sequence, 1, 1, CONTROLS_ID, 0) + payload
    return frame + checksum(frame, CONTROLS_EXTRA)


class Peer:
    """Answers ODOMETRY on a port of its own with a small pitch damper; a script may do otherwise.

    script(peer, time_us) returns the datagrams to send; None is the plain answer.
    """

    def __init__(self, port: int = 0, script: Script | None = None) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.port = self.socket.getsockname()[1]
        self.link = f"udpout:127.0.0.1:{self.port}"
        self.times: list[int] = []
        self.reset_counters: set[int] = set()
        self.statuses: list[int] = []
        self.ids: list[int] = []
        self.acks: list[bytes] = []
        self.state: tuple[float, ...] = ()
        self._script = script
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def plain(self, time_us: int) -> bytes:
        """Return the command of the pitch damper for the last state."""
        pitch_rate = self.state[11]
        return controls_frame(time_us, [max(-1.0, min(1.0, -0.14 + 2.0 * pitch_rate)), 0.0, 0.0])

    def _run(self) -> None:
        self.socket.settimeout(0.02)
        while not self._stop.is_set():
            try:
                frame, sender = self.socket.recvfrom(4096)
            except TimeoutError:
                continue
            except OSError:
                return
            for reply in self._answers(frame):
                self.socket.sendto(reply, sender)

    def _answers(self, frame: bytes) -> list[bytes]:
        kind = frame[7] | frame[8] << 8 | frame[9] << 16
        self.ids.append(kind)
        if kind == 0:
            self.statuses.append(frame[10 + 7])
        if kind == 77:
            self.acks.append(frame[10:13])
        if kind != ODOMETRY_ID:
            return []
        assert checksum(frame[:-2], ODOMETRY_EXTRA) == frame[-2:]
        time_us, *state = struct.unpack("<Q13f", frame[10:70])
        self.reset_counters.add(frame[10 + 230])
        self.times.append(time_us)
        self.state = tuple(state)
        assert all(map(math.isfinite, state))
        return [self.plain(time_us)] if self._script is None else self._script(self, time_us)

    def close(self) -> None:
        """End as a killed process does: the port is closed at once."""
        self._stop.set()
        self._thread.join()
        self.socket.close()


@pytest.fixture
def peer_factory() -> Iterator[Callable[..., Peer]]:
    """Make peers that are closed after the test."""
    peers: list[Peer] = []

    def make(port: int = 0, script: Script | None = None) -> Peer:
        peers.append(Peer(port, script))
        return peers[-1]

    yield make
    for peer in peers:
        peer.close()


@pytest.fixture
def frame_of() -> Callable[..., bytes]:
    """Return the maker of command frames."""
    return controls_frame
