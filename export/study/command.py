"""``python -m export.study``: one subcommand for each table or figure of the thesis."""

from __future__ import annotations

import click

from export.study.curves import curves
from export.study.mutation import mutation
from export.study.smoothness import smoothness
from export.study.sweep import sweep
from export.study.table71 import table71


@click.group()
def study() -> None:
    """Measure the thesis's tables and figures again, on this aircraft."""


for command in (table71, curves, smoothness, mutation, sweep):
    study.add_command(command)
