"""Flights in a process of their own, so that one core flies while another learns."""

from __future__ import annotations

import multiprocessing
import os
import signal
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from export.network import Network
from export.training.config import TaskSettings
from export.training.flights import Flights
from export.training.rollouts import CitationRollouts
from task.errors import UserError


class Order(NamedTuple):
    """Everything that flights depend on."""

    network: Network
    parameters: np.ndarray
    """(P, K) float32."""
    tasks: np.ndarray
    noise: np.ndarray


def _serve(pipe: Connection, settings: TaskSettings, discount_penalty: bool) -> None:
    """Fly what is ordered until the other end of the pipe is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C reaches both; who orders decides when to stop
    rollouts = CitationRollouts(settings, discount_penalty)
    try:
        while True:
            pipe.send([rollouts.fly(*order) for order in pipe.recv()])
    except (EOFError, BrokenPipeError):
        return


class FlightWorker:
    """A process that owns aircraft of its own and flies what is ordered, one list at a time."""

    def __init__(self, settings: TaskSettings, discount_penalty: bool) -> None:
        """Start the process; it ends with this one, however this one ends."""
        context = multiprocessing.get_context("spawn")  # threads of the tensor library do not survive a fork
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, settings, discount_penalty), daemon=True)
        threads = os.environ.get("OMP_NUM_THREADS")
        os.environ["OMP_NUM_THREADS"] = "1"  # for the process that starts now: flights are made of small products
        self._process.start()
        if threads is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = threads
        theirs.close()

    def start(self, orders: list[Order]) -> None:
        """Order flights; return at once."""
        try:
            self._pipe.send(orders)
        except OSError:
            raise self._ended() from None

    def result(self) -> list[Flights]:
        """Wait for the flights that were ordered."""
        try:
            return self._pipe.recv()
        except (EOFError, OSError):
            raise self._ended() from None

    @staticmethod
    def _ended() -> UserError:
        return UserError("the process that flies ended before its flights; the same command goes on")

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join(timeout=5.0)
        if self._process.is_alive():
            self._process.kill()
