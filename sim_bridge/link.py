"""The UDP socket to the runtime: datagrams out and in, with bounded waits, never an exception in flight."""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import time

from task.errors import UserError

_DATAGRAM = 4096
"""Largest datagram that is read whole [bytes]: a dozen of the largest frames."""


def parse_address(link: str) -> tuple[str, int]:
    """Return host and port of ``udpout:HOST:PORT``; raise UserError for anything else."""
    kind, _, rest = link.partition(":")
    host, _, port = rest.rpartition(":")
    if kind == "udpin":
        raise UserError(f"--link {link}: the bridge calls and the runtime is bound; expected udpout:HOST:PORT")
    if kind != "udpout" or not host:
        raise UserError(f"--link {link}: expected udpout:HOST:PORT, for example udpout:127.0.0.1:14560")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise UserError(f"--link {link}: expected a port from 1 to 65535, got '{port}'")
    return host, int(port)


class Link:
    """A connected UDP socket: only what the runtime's own address sends is heard, and a closed port is noticed.

    Raises UserError when the address cannot be resolved or reached from this machine.
    """

    def __init__(self, link: str) -> None:
        host, port = parse_address(link)
        self.address = f"{host}:{port}"
        self.refused = False
        """Whether the other side's port was found closed since this was last cleared."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect((host, port))
        except OSError as error:
            self._socket.close()
            raise UserError(f"--link {link}: cannot reach {host}: {error.strerror}; check the address") from None
        except (ValueError, TypeError):
            self._socket.close()
            raise UserError(f"--link {link}: cannot reach {host}: it is no name of a host; check the address") from None
        self._socket.setblocking(False)

    def send(self, datagram: bytes) -> None:
        """Send one datagram; what the network will not take is lost, as any datagram may be."""
        try:
            self._socket.send(datagram)
        except ConnectionRefusedError:
            # Tells of an earlier datagram that met a closed port; this one has not been sent yet.
            self.refused = True
            with contextlib.suppress(OSError):
                self._socket.send(datagram)
        except OSError:
            pass

    def receive(self, until: float) -> bytes | None:
        """Return the next datagram; None when none comes by ``until`` [s, time.perf_counter] or the port is closed.

        With ``until`` in the past, what is already there is still returned.
        """
        while select.select([self._socket], [], [], max(until - time.perf_counter(), 0.0))[0]:
            try:
                return self._socket.recv(_DATAGRAM)
            except BlockingIOError:
                # The kernel dropped what woke us (a bad UDP checksum): wait on.
                continue
            except OSError as error:
                self.refused |= error.errno == errno.ECONNREFUSED
                return None
        return None

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
