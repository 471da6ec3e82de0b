"""The command line of the bridge."""

from __future__ import annotations

import math
import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any

import click
import msgspec

from sim_bridge.bridge import Bridge, Summary
from sim_bridge.codec import require_fast_checksums
from sim_bridge.exchange import Timing
from sim_bridge.flight import Flight
from sim_bridge.link import Link
from sim_bridge.truth import prepare, write_whole
from task.config import load_toml, to_json
from task.errors import UserError

DEFAULT_LINK = "udpout:127.0.0.1:14560"


class _Stop:
    """Turns SIGINT and SIGTERM into a request that the cycle looks at; remembers which it was."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self.signal = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        self._event.set()

    def __call__(self) -> bool:
        return self._event.is_set()


class _Seconds(click.FloatRange):
    """A time; click's range lets nan pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the time; what is no number is refused."""
        seconds = super().convert(value, param, ctx)
        if math.isnan(seconds):
            self.fail(f"expected a number of seconds, got {value}", param, ctx)
        return seconds


_SECONDS = _Seconds(min=0.0, max=86400.0, min_open=True)


@click.command()
@click.option("--flight", "flight_path", type=Path, help="The flight, a TOML file (sim_bridge.flight.Flight).")
@click.option("--link", "address", default=DEFAULT_LINK, show_default=True, help="Where the runtime is bound.")
@click.option("--truth", type=Path, default=Path("truth.npz"), show_default=True, help="Where the true states go.")
@click.option("--summary", type=Path, help="Where the summary goes.  [default: beside the truth, .summary.json]")
@click.option("--realtime", is_flag=True, help="100 Hz of wall clock; without it, lockstep.")
@click.option("--seed", type=click.IntRange(min=0), help="Overrides the flight's seed.")
@click.option("--duration", type=_SECONDS, help="Overrides the flight's duration [s].")
@click.option("--patience", type=_SECONDS, default=Timing().patience, show_default=True,
              help="How long nobody may answer before the flight is given up [s].")  # fmt: skip
@click.option("--reply-timeout", type=_SECONDS, default=Timing().reply_timeout, show_default=True,
              help="How long one reply is waited for in lockstep [s].")  # fmt: skip
def bridge(
    flight_path: Path | None,
    address: str,
    truth: Path,
    summary: Path | None,
    realtime: bool,
    seed: int | None,
    duration: float | None,
    patience: float,
    reply_timeout: float,
) -> None:
    """Put the Citation behind MAVLink (docs/interface.md)."""
    require_fast_checksums()
    flight = load_toml(flight_path, Flight, "flight") if flight_path else Flight()
    changes = {"seed": seed, "duration": duration}
    flight = msgspec.structs.replace(flight, **{k: v for k, v in changes.items() if v is not None})
    prepare(truth)
    summary_path = summary or truth.with_suffix(".summary.json")
    prepare(summary_path)
    stop = _Stop()
    timing = Timing(patience=patience, reply_timeout=reply_timeout)
    with Link(address) as link:
        flown = Bridge(flight, link, realtime, timing, stop, lambda line: click.echo(f"bridge: {line}", err=True))
        result = flown.fly()
    flown.truth.save(truth)
    write_whole(summary_path, lambda file: file.write(to_json(result)))
    _report(result, truth, stop.signal)


def _report(result: Summary, truth: Path, stopped_by: int) -> None:
    """Say in one line how the flight ended, and leave with 0, 2 (no runtime) or 128 + signal."""
    saved = f"true states in {truth}"
    if result.outcome == "no runtime":
        raise UserError(f"{result.reason}; {saved}")
    if result.outcome == "stopped":
        click.echo(f"bridge: {result.reason} by {signal.Signals(stopped_by).name}; {saved}", err=True)
        sys.exit(128 + stopped_by)
    link = result.link
    told = result.reason or f"{result.ticks} ticks in {result.wall_seconds:.1f} s"
    click.echo(f"bridge: {told}; late {link.late}, refused {sum(link.refused.values())}; {saved}", err=True)
