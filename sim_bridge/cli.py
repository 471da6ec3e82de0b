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
from sim_bridge.flight import LONGEST, SHORTEST, Flight
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
    """A number of seconds within a range; not-a-number, which no comparison finds, is outside."""

    name = "seconds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        number: float = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"expected a number of seconds, got {value}", param, ctx)
        return number


_WAIT = _Seconds(min=0.0, max=86400.0, min_open=True)


@click.command()
@click.option("--flight", "flight_path", type=Path, help="The flight, a TOML file (sim_bridge.flight.Flight).")
@click.option("--link", "address", default=DEFAULT_LINK, show_default=True, help="Where the runtime is bound.")
@click.option("--truth", type=Path, default=Path("truth.npz"), show_default=True, help="Where the true states go.")
@click.option("--summary", type=Path, help="Where the summary goes.  [default: beside the truth, .bridge.json]")
@click.option("--realtime", is_flag=True, help="100 Hz of wall clock; without it, lockstep.")
@click.option("--seed", type=click.IntRange(min=0), help="Overrides the flight's seed.")
@click.option("--duration", type=_Seconds(min=SHORTEST, max=LONGEST), help="Overrides the flight's duration [s].")
@click.option("--patience", type=_WAIT, default=Timing().patience, show_default=True,
              help="How long nobody may answer before the flight is given up [s].")  # fmt: skip
@click.option("--reply-timeout", type=_WAIT, default=Timing().reply_timeout, show_default=True,
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
    # Not .summary.json: that is the runtime's, beside a log of the same name.
    summary_path = summary or truth.with_suffix(".bridge.json")
    _keep_apart({"--flight": flight_path, "--truth": truth, "--summary": summary_path})
    prepare(summary_path)
    for fault in flight.beyond_its_end():
        click.echo(f"bridge: {fault}; it will not be seen", err=True)
    stop = _Stop()
    timing = Timing(patience=patience, reply_timeout=reply_timeout)
    with Link(address) as link:
        flown = Bridge(flight, link, realtime, timing, stop, lambda line: click.echo(f"bridge: {line}", err=True))
        result = flown.fly()
    flown.truth.save(truth)
    write_whole(summary_path, lambda file: file.write(to_json(result)))
    _report(result, truth, stop.signal)


def _keep_apart(files: dict[str, Path | None]) -> None:
    """See that no file is written over another. Raises UserError."""
    seen: dict[Path, str] = {}
    for option, path in files.items():
        if path is not None and (other := seen.setdefault(path.resolve(), option)) != option:
            raise UserError(f"{option} {path}: is {other}'s file too; expected one of its own, give it another name")


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
