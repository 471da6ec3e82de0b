"""The ``understudy`` command: one group whose subcommands load only what they need."""

from __future__ import annotations

import importlib
import sys

import click

from task.errors import UserError

COMMANDS = {
    "fly": ("scenarios.cli:fly", "Fly a scripted scenario in several modes and report."),
    "runtime": ("runtime.cli:main", "Fly any simulator or aircraft that speaks docs/interface.md."),
    "bridge": ("sim_bridge.cli:bridge", "Put the Citation behind MAVLink."),
    "aircraft": ("sim_bridge.aircraft.cli:aircraft", "Identify, build and validate the Citation."),
    "train": ("export.training.cli:train", "Train a population with SERL."),
    "export": ("export.cli:export", "Export a trained population to ONNX."),
    "results": ("scenarios.cli:results", "Render docs/results.md from results/*.json."),
}
"""Subcommand: where it lives, and its line of help; nothing is imported before it is asked for."""


class LazyGroup(click.Group):
    """A group that imports a subcommand when it runs, so that the runtime never pulls in the offline side."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the subcommands in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return one subcommand; say which extra is missing when it cannot be imported."""
        if cmd_name not in COMMANDS:
            return None
        module, name = COMMANDS[cmd_name][0].split(":")
        try:
            return getattr(importlib.import_module(module), name)
        except ModuleNotFoundError as error:
            if error.name and error.name.split(".")[0] == module.split(".")[0]:
                raise
            extra = "export" if module.startswith("export") else "sim"
            raise UserError(
                f"'understudy {cmd_name}' needs {error.name}, which is not installed; here: pip install '.[{extra}]'"
            ) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the subcommands from the table, without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.command(cls=LazyGroup)
@click.version_option(package_name="understudy")
def cli() -> None:
    """Understudy: keep an aircraft flying well after it has suddenly changed."""


def run(command: click.Command) -> None:
    """Run a command; a UserError becomes its one line on stderr and exit code 2."""
    try:
        command()
    except UserError as error:
        click.echo(f"understudy: {error}", err=True)
        sys.exit(2)


def main() -> None:
    """Entry point of the ``understudy`` script."""
    run(cli)


if __name__ == "__main__":
    main()
