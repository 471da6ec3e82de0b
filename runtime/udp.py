"""UDP addresses as they are written on the command line, and the socket behind them."""

from __future__ import annotations

import errno
import socket
from typing import NamedTuple

from task.errors import UserError

Peer = tuple[str, int]
"""Host and port."""


class Address(NamedTuple):
    """``udpin:HOST:PORT`` is bound and answers who speaks; ``udpout:HOST:PORT`` speaks first."""

    text: str
    bind: bool
    peer: Peer


def parse_address(text: str) -> Address:
    """Return the address that ``text`` spells; raise UserError for anything else."""
    kind, _, rest = text.partition(":")
    host, _, port = rest.rpartition(":")
    if kind not in ("udpin", "udpout") or not host:
        raise UserError(f"--link {text}: expected udpin:HOST:PORT or udpout:HOST:PORT, as in udpin:127.0.0.1:14560")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise UserError(f"--link {text}: expected a port from 1 to 65535, got '{port}'")
    return Address(text, kind == "udpin", (host, int(port)))


def resolve(address: Address) -> Peer:
    """Return the peer with its host as a number; raise UserError when nobody knows it."""
    host, port = address.peer
    try:
        found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
    except (OSError, ValueError, TypeError) as error:  # what cannot be a host's name is a UnicodeError, or a TypeError
        why = error.strerror if isinstance(error, OSError) else "it is no name of a host"
        raise UserError(f"--link {address.text}: cannot resolve {host}: {why}; check the address") from None
    return str(found[0]), port


def open_socket(address: Address) -> socket.socket:
    """Return the socket, bound when the address says so; raise UserError when that cannot be."""
    here = resolve(address) if address.bind else ("", 0)
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        udp.bind(here)
    except OSError as error:
        udp.close()
        if error.errno == errno.EADDRINUSE:
            raise UserError(
                f"--link {address.text}: port {address.peer[1]} is in use; stop what uses it or choose another"
            ) from None
        raise UserError(f"--link {address.text}: cannot listen there: {error.strerror}; check the address") from None
    udp.setblocking(False)
    return udp
