"""The command line of the runtime."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from pathlib import Path
from types import FrameType

import click

from runtime.config import Configuration
from runtime.laws.catalogue import load_solo
from runtime.laws.solo import Solo
from runtime.loop import Outcome
from runtime.mavlink_link import MavlinkLink
from runtime.population import Population, load_population
from runtime.presets import PRESETS, resolve
from runtime.reference import LiveReference, load_reference
from runtime.session import Flown, Session, members_of
from runtime.udp import parse_address
from task.errors import UserError
from task.files import find_population
from task.law_names import LAWS, OWN, why_no_law

SILENT_EXIT = 3
"""Exit code when the aircraft's side fell silent in mid-flight, or the link failed."""
LOST_EXIT = 4
"""Exit code when the flight is over, but a log or what accompanies it could not be written whole."""


class _Stop:
    """Turns SIGINT and SIGTERM into a request that the loop looks at; remembers which it was."""

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


def _say(line: str) -> None:
    """Say a line on stderr; nobody listening is no reason to stop flying."""
    with contextlib.suppress(OSError):
        click.echo(f"runtime: {line}", err=True)


def _configure(
    population: Path | None,
    law: str | None,
    preset: str | None,
    config: Path | None,
    overrides: tuple[str, ...],
    switch: str | None,
    realtime: bool,
) -> Configuration:
    """Return the configuration; with a law nothing is switched and no prior is there to start from."""
    if (population is None) == (law is None):
        got = "none of them" if law is None else "both"
        raise UserError(f"expected either --population FOLDER or --law {'|'.join(LAWS)}, got {got}")
    if law is None:
        return resolve(preset, config, overrides, switch, realtime)
    if wrong := why_no_law(law):
        raise UserError(f"--law: {wrong}")
    if switch not in (None, "none"):
        raise UserError(f"--law {law}: flies alone; expected --switch none or no --switch, got {switch}")
    return resolve(preset, config, (*overrides, "prior=none", "effectiveness=none"), "none", realtime)


def _load(population: Path | None, law: str | None, configuration: Configuration) -> Population | Solo:
    """Return who flies."""
    if law is not None:
        return load_solo(law, configuration.operation.dt)
    assert population is not None  # _configure saw to it
    return load_population(find_population(population))


def _describe(cast: Population | Solo, configuration: Configuration) -> str:
    """Return in words who flies and how the cast changes."""
    if isinstance(cast, Solo):
        return f"the law {cast.name} flies alone"
    adaptation = configuration.adaptation
    members, first = members_of(cast, adaptation), adaptation.first or cast.members[cast.champion]
    return (
        f"{cast.name}, {len(members)} members, {first} flies first; "
        f"preset {configuration.preset}, switch {adaptation.switch}"
    )


@click.command()
@click.option("--link", "address", default="udpin:0.0.0.0:14560", show_default=True,
              help="udpin:HOST:PORT is bound and answers who speaks; udpout:HOST:PORT speaks first.")  # fmt: skip
@click.option("--population", type=Path,
              help="The cast: a folder that 'understudy export' wrote, or its name under populations/.")  # fmt: skip
@click.option("--law", metavar="NAME",
              help=f"Fly a law instead of a population: {', '.join(LAWS)}, or {OWN} of your own.")  # fmt: skip
@click.option("--reference", "reference_path", type=Path,
              help="CSV or NPY of t, theta, phi, beta [s, rad].  [default: follow SET_ATTITUDE_TARGET]")  # fmt: skip
@click.option("--preset", type=click.Choice(list(PRESETS)),
              help="Parameters of the adaptation; ensemble for 'citation'.  [default: understudy]")  # fmt: skip
@click.option("--switch", type=click.Choice(["none", "hard", "soft"]), help="How the cast changes.  [default: soft]")
@click.option(
    "--config",
    type=Path,
    help="TOML with [adaptation] and [operation] tables, over the preset; or a flight's .config.json.",
)
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override one value; may be repeated.")
@click.option("--log", type=Path, default=Path("flight.ulg"), show_default=True,
              help="The flight log (ULog); configuration and summary are written beside it.")  # fmt: skip
@click.option("--realtime", is_flag=True, help="Keep the wall clock; without it, lockstep.")
def main(
    address: str,
    population: Path | None,
    law: str | None,
    reference_path: Path | None,
    preset: str | None,
    switch: str | None,
    config: Path | None,
    overrides: tuple[str, ...],
    log: Path,
    realtime: bool,
) -> None:
    """Fly whatever speaks docs/interface.md with a population (a cast that adapts in flight) or with one law.

    Options, keys of --set, log and exit codes: docs/operations.md.
    """
    configuration = _configure(population, law, preset, config, overrides, switch, realtime)
    where = parse_address(address)
    cast = _load(population, law, configuration)
    live = LiveReference()
    reference = load_reference(reference_path, configuration.operation.dt) if reference_path else live
    stop = _Stop()
    link = MavlinkLink(
        where,
        lockstep=not configuration.operation.real_time,
        say_here=_say,
        on_setpoint=None if reference_path else live.set,
    )
    try:
        with Session(link, cast, reference, configuration, log, _say, stop) as session:
            _say(f"{_describe(cast, configuration)}; waiting on {where.text}")
            flown = session.fly()
    finally:
        link.close()
    _leave(flown, link, stop.signal)


def _leave(flown: list[Flown], link: MavlinkLink, stopped_by: int) -> None:
    """Say in one line how it ended, and leave with 0, 3 (silence, or no link), 4 (a record is lost) or 128 + signal."""
    if not flown:
        _say(f"stopped by {signal.Signals(stopped_by).name} before any state came; nothing flown")
        sys.exit(128 + stopped_by)
    outcome, log, summary, lost, failure = flown[-1]
    silence = link.silence() if summary.cycles else link.diagnosis()
    ended = {
        Outcome.OVER: "flight over",
        Outcome.LOST: "the aircraft is lost",
        Outcome.SILENT: f"the aircraft's side fell silent ({silence})",
        Outcome.STOPPED: f"stopped by {signal.Signals(stopped_by).name}" if stopped_by else "stopped",
        Outcome.REPLACED: "replaced",
        Outcome.FAILED: f"the link failed ({failure})",
    }[outcome]
    _say(
        f"{ended} after {summary.seconds:.1f} s; {summary.cycles} cycles, {summary.switches} switches, "
        f"{summary.missed + summary.gaps} missed; "
        f"{'its record is not whole, see above: ' if lost else 'log in '}{log}"
    )
    if outcome in (Outcome.SILENT, Outcome.FAILED):
        sys.exit(SILENT_EXIT)
    if outcome is Outcome.STOPPED:
        sys.exit(128 + stopped_by)
    if any(flight.lost for flight in flown):
        sys.exit(LOST_EXIT)
