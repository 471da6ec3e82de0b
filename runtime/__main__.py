"""``python -m runtime``."""

from __future__ import annotations

import sys

import click

from runtime.cli import main
from task.errors import UserError

if __name__ == "__main__":
    try:
        main(prog_name="python -m runtime")
    except UserError as error:
        click.echo(f"runtime: {error}", err=True)
        sys.exit(2)
