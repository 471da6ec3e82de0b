"""The ``understudy`` command: one group whose subcommands load only what they need."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import sys
from collections.abc import Iterator

import click

from task.errors import UserError

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

COMMANDS = {
    "fly": ("scenarios.cli:fly", "Fly a scripted scenario in several modes; table and report."),
    "runtime": ("runtime.cli:main", "Fly any simulator or aircraft that speaks docs/interface.md."),
    "bridge": ("sim_bridge.cli:bridge", "Put the Citation behind MAVLink."),
    "aircraft": ("sim_bridge.aircraft.cli:aircraft", "Identify, build and validate the Citation."),
    "train": ("export.training.cli:train", "Train a population with SERL."),
    "export": ("export.cli:export", "Export a trained population to ONNX."),
    "results": ("scenarios.cli:results", "Render docs/results.md from results/*.json."),
}
"""Subcommand: where it lives, and its line of help; nothing is imported before it is asked for."""

EXTRAS = {"export": "export", "bench": "dev"}
"""The extra that installs what a package needs; ``sim`` where none is named."""


class LazyGroup(click.Group):
    """A group that imports a subcommand when it runs, so that the runtime never pulls in the offline side."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the subcommands in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return one subcommand; say which extra is missing when it cannot be imported."""
        if cmd_name not in COMMANDS:
            return None
        return _imported(COMMANDS[cmd_name][0], f"understudy {cmd_name}")

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the subcommands from the table, without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.command(cls=LazyGroup)
@click.version_option(package_name="understudy")
def cli() -> None:
    """Understudy: keep an aircraft flying well after it has suddenly changed.

    A first flight: understudy fly crossed_controls. The campaign: python -m scenarios.campaign. More: README.md.
    """


@contextlib.contextmanager
def stopping(how_to_go_on: str) -> Iterator[None]:
    """Turn Ctrl-C in what is within into one line and exit code 130."""
    try:
        yield
    except KeyboardInterrupt:
        click.echo(f"understudy: stopped; {how_to_go_on}", err=True)
        sys.exit(INTERRUPTED)


def run(command: click.Command | str) -> None:
    """Run a command; a UserError becomes its one line on stderr and exit code 2, Ctrl-C one line and exit code 130.

    ``module:name`` is imported first: what goes wrong there is said in the same way.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # no terminal is too poor for a report
    os.environ["MPLBACKEND"] = "agg"  # pictures go into files, whatever the environment names
    try:
        code = _named(command).main(standalone_mode=False)
    except UserError as error:
        click.echo(f"understudy: {error}", err=True)
        sys.exit(2)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("understudy: stopped", err=True)
        sys.exit(INTERRUPTED)
    sys.exit(code if isinstance(code, int) else 0)


def _named(command: click.Command | str) -> click.Command:
    if isinstance(command, click.Command):
        return command
    return _imported(command, f"python -m {command.split(':')[0].rpartition('.')[0]}")


def _imported(place: str, typed: str) -> click.Command:
    """Import and return the command at ``module:name``; raise UserError when what ``typed`` needs is not installed."""
    module, name = place.split(":")
    package = module.split(".")[0]
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        if error.name and error.name.split(".")[0] == package:
            raise
        extra = EXTRAS.get(package, "sim")
        raise UserError(
            f"'{typed}' needs {error.name}, which is not installed; here: pip install '.[{extra}]'"
        ) from None


def main() -> None:
    """Entry point of the ``understudy`` script."""
    run(cli)


if __name__ == "__main__":
    main()
