"""A streaming writer of ULog (docs.px4.io, ULog file format): readable by pyulog, PlotJuggler and Flight Review.

Deterministic: the bytes depend on what is written alone. Only whole records reach the operating system, so that a log
cut short by a kill -9 is readable to its last flush.
"""

from __future__ import annotations

import math
import queue
import struct
import threading
import time
from io import FileIO
from pathlib import Path

_MAGIC = b"ULog\x01\x12\x35\x01"
_CODES = {
    "uint64_t": "Q",
    "uint32_t": "I",
    "uint16_t": "H",
    "uint8_t": "B",
    "int16_t": "h",
    "int32_t": "i",
    "double": "d",
    "float": "f",
}
_RANGES = {
    "Q": (0, 2**64 - 1),
    "I": (0, 2**32 - 1),
    "H": (0, 2**16 - 1),
    "B": (0, 2**8 - 1),
    "h": (-(2**15), 2**15 - 1),
    "i": (-(2**31), 2**31 - 1),
}
"""Least and greatest value of each kind of integer."""
_FLOAT_MAX = 3.4028234663852886e38
"""Greatest number of float32."""
_LONGEST = 0xFFFF
"""Bytes of the longest message."""


def _fitted(code: str, value: float) -> float:
    """Return a number as its field can hold it: infinite beyond float32, integers at the end of their range."""
    if code == "d":
        return value
    if code == "f":
        return math.copysign(math.inf, value) if abs(value) > _FLOAT_MAX else value
    low, high = _RANGES[code]
    return 0 if math.isnan(value) else int(min(max(value, low), high))


class Topic:
    """One kind of record: a timestamp [us] and named fields, an array where a field says so."""

    def __init__(self, number: int, name: str, fields: list[tuple[str, str]]) -> None:
        self.name = name
        self.text = f"{name}:uint64_t timestamp;" + "".join(f"{kind} {field};" for kind, field in fields)
        codes = "Q"
        for kind, _ in fields:
            base, _, count = kind.partition("[")
            codes += (int(count[:-1]) if count else 1) * _CODES[base]
        layout = f"<HBH{codes}"
        self._codes = codes
        self._pack = struct.Struct(layout).pack
        self._size = struct.calcsize(layout) - 3
        self._number = number

    def record(self, timestamp: int, *values: float) -> bytes:
        """Return one data message; a number that its field cannot hold is brought to the end of the field's range."""
        try:
            return self._pack(self._size, ord("D"), self._number, timestamp, *values)
        except (struct.error, OverflowError):  # only now, since looking at each number would double the cost
            numbers = zip(self._codes, (timestamp, *values), strict=True)
            return self._pack(self._size, ord("D"), self._number, *(_fitted(*number) for number in numbers))


class ULog:
    """A log being written. Order: information, parameters and topics, then :meth:`begin`, then records and messages.

    ``threaded`` hands blocks to a thread, so that a slow disk cannot hold the caller up. While more than ``WAITING`` is
    not on the disk yet, whole blocks are dropped, counted, and marked in the log by a dropout. After an error of the
    disk, from the first byte on, nothing more is written. ``error`` says what is missing and why; nothing raises.
    """

    WAITING = 2**24
    """Bytes that wait for the disk at most: some ten minutes of a flight."""
    CLOSE_PATIENCE = 10.0
    """How long the disk may take for what waits at the end of a flight [s]; then the log ends where it is."""

    def __init__(self, path: Path, threaded: bool = False) -> None:
        self.path = path
        self.error = ""
        self.dropped = 0
        """Records and messages that the disk was too slow for."""
        self.hangs = False
        """Whether the disk did not even take the end of the log."""
        self._records = 0
        """In the block that is being filled."""
        self._dropping_since: float | None = None
        """[s of wall clock]"""
        self._given = self._taken = 0
        """Bytes handed to the thread, and written by it; each has one writer, so that no lock is asked for."""
        self._file: FileIO | None = None
        try:
            self._file = FileIO(path, "w")
        except OSError as error:
            self.error = f"{path}: cannot write the log: {error.strerror}"
        self._topics: list[Topic] = []
        self._block = bytearray(_MAGIC + bytes(8))
        self._message(b"B", bytes(40))
        self._blocks: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._drain, name="log", daemon=True) if threaded else None
        if self._thread is not None:
            self._thread.start()

    def _message(self, kind: bytes, payload: bytes) -> None:
        self._block += struct.pack("<H", len(payload)) + kind + payload

    def info(self, key: str, text: str) -> None:
        """Write a piece of information."""
        value = text.encode()
        name = f"char[{len(value)}] {key}".encode()
        self._message(b"I", bytes([len(name)]) + name + value)

    def parameter(self, key: str, value: float) -> None:
        """Write a parameter: int32 for integers and flags, float for the rest."""
        whole = isinstance(value, int)
        code = "i" if whole else "f"
        name = f"{'int32_t' if whole else 'float'} {key}".encode()
        self._message(b"P", bytes([len(name)]) + name + struct.pack(f"<{code}", _fitted(code, value)))

    def topic(self, name: str, fields: list[tuple[str, str]]) -> Topic:
        """Declare a topic with fields (type, name); the timestamp is added."""
        topic = Topic(len(self._topics), name, fields)
        self._topics.append(topic)
        self._message(b"F", topic.text.encode())
        return topic

    def begin(self) -> None:
        """End the definitions."""
        for number, topic in enumerate(self._topics):
            self._message(b"A", struct.pack("<BH", 0, number) + topic.name.encode())
        self.flush()

    def write(self, topic: Topic, timestamp: int, *values: float) -> None:
        """Write one record; ``timestamp`` in microseconds."""
        self._block += topic.record(timestamp, *values)
        self._records += 1

    def message(self, timestamp: int, severity: int, text: str) -> None:
        """Write a line of text; severity 0..7 as in MAV_SEVERITY."""
        start = struct.pack("<BQ", ord("0") + severity, int(_fitted("Q", timestamp)))
        self._message(b"L", start + text.encode(errors="replace")[: _LONGEST - len(start)])
        self._records += 1

    def flush(self) -> None:
        """Hand what was written to the operating system."""
        if not self._block:
            return
        block, self._block = self._block, bytearray()
        records, self._records = self._records, 0
        if self._thread is not None:
            self._hand_over(bytes(block), records)
        else:
            self._write(block)

    def _hand_over(self, block: bytes, records: int) -> None:
        """Give a block to the thread, or drop it where too much waits already."""
        now = time.monotonic()
        if self._given - self._taken + len(block) > self.WAITING:
            self.dropped += records
            if self._dropping_since is None:
                self._dropping_since = now
            return
        if self._dropping_since is not None:
            duration = min(round(1e3 * (now - self._dropping_since)), 0xFFFF)  # [ms]
            block, self._dropping_since = struct.pack("<HBH", 2, ord("O"), duration) + block, None
        self._given += len(block)
        self._blocks.put(block)

    @property
    def dropping(self) -> bool:
        """Whether what is written is being lost."""
        return self._dropping_since is not None

    def _write(self, block: bytes | bytearray) -> None:
        view = memoryview(block)
        try:
            while view and self._file is not None and not self.error:
                view = view[self._file.write(view) or 0 :]
        except OSError as error:
            self.error = f"{self.path}: the log ends here: {error.strerror}"

    def _drain(self) -> None:
        while (block := self._blocks.get()) is not None:
            self._write(block)
            self._taken += len(block)
        self._close_file()

    def close(self) -> None:
        """Write what is left and close the file; a disk that hangs is waited for ``CLOSE_PATIENCE``."""
        self.flush()
        if self._thread is None:
            self._close_file()
            return
        self._blocks.put(None)
        self._thread.join(self.CLOSE_PATIENCE)
        self.hangs = self._thread.is_alive()
        if self.hangs:
            self.error = f"{self.path}: the log ends early: the disk took nothing more for {self.CLOSE_PATIENCE:g} s"
        if self.dropped:
            words = f"{self.dropped} records are missing that the disk was too slow for"
            self.error = f"{self.error}; {words}" if self.error else f"{self.path}: {words}"

    def _close_file(self) -> None:
        try:
            if self._file is not None:
                self._file.close()
        except OSError as error:  # what a server's disk had no room for may be told as late as this
            self.error = self.error or f"{self.path}: the log ends here: {error.strerror}"
