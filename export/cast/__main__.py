"""Entry of ``python -m export.cast``."""

from __future__ import annotations

import sys

import click

from export.cast.cli import main
from task.errors import UserError

if __name__ == "__main__":
    try:
        main(standalone_mode=True)
    except UserError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(2)
