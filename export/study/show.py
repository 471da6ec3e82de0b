"""What a study shows on the screen while it runs and when it is done."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table as Shown

from export.study.campaign import Progress as Advance
from task.results import Table


@contextmanager
def flights_progress(total: int, what: str = "flights") -> Iterator[Advance]:
    """Show how many of ``total`` are done, and when the rest will be; give what is to be told of each."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.advance(task, done)


def show(tables: Sequence[Table]) -> None:
    """Print tables."""
    console = Console()
    for table in tables:
        shown = Shown(title=table.title)
        for column in table.columns:
            shown.add_column(column, justify="right")
        for row in table.rows:
            shown.add_row(*map(str, row))
        console.print(shown)
