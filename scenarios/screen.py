"""What the terminal shows: progress while the flights go on, and the table at the end."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from scenarios.panels import colour
from scenarios.report import best_row
from scenarios.run import Job, Result
from scenarios.summary import Row, cells

LEGEND = (
    "nMAE: normalised tracking error, mean of θ, φ, β. Vs none: its change against no adaptation. Sm: smoothness of "
    "the commands, nearer to 0 is smoother. Step: largest command step. All columns: see the report."
)
"""What the columns of the table mean, in short; the report says it in full."""


class Board:
    """Bars for the flights under way and for all of them; plain lines where the output is no terminal."""

    def __init__(self, console: Console, flights: int) -> None:
        self._console = console
        self._count = 0
        self._lock = threading.Lock()
        self._flights = flights
        self._tasks: dict[str, TaskID] = {}
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(bar_width=30), TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True,
            disable=not console.is_terminal,
        )  # fmt: skip
        self._all = self._progress.add_task("all flights", total=float(flights))

    def __enter__(self) -> Board:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def started(self, job: Job) -> None:
        """Show a bar for a flight that begins."""
        self._tasks[job.name] = self._progress.add_task(escape(job.name), total=1.0)

    def moved(self, job: Job, fraction: float) -> None:
        """Move its bar."""
        self._progress.update(self._tasks[job.name], completed=fraction)

    def finished(self, job: Job, result: Result) -> None:
        """Take its bar away and say in a line how it went."""
        task = self._tasks.pop(job.name, None)
        if task is not None:
            self._progress.remove_task(task)
        self._progress.advance(self._all)
        score = result.score
        how = "flown before" if result.reused else f"{result.seconds:.1f} s"
        ended = f"nMAE {score.nmae:6.2f} %" if score.survived else f"lost at {score.lost_at:.1f} s"
        with self._lock:
            self._count += 1
            self._console.print(
                f"[dim]{self._count:>3}/{self._flights}[/]  {escape(f'{job.name:<32}')} {ended:<18} [dim]{how}[/]",
                highlight=False,
            )


def print_table(console: Console, title: str, rows: Sequence[Row]) -> None:
    """Print one row for each mode; the best one is bold."""
    headings, body = cells(rows)
    table = Table(
        title=escape(title), title_justify="left", title_style="bold", box=None, padding=(0, 1), header_style="dim"
    )
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i == 0 else "right", no_wrap=True)
    best = best_row(rows)
    for i, line in enumerate(body):
        table.add_row(f"[{colour(line[0])}]●[/] {line[0]}", *line[1:], style="bold" if i == best else "")
    console.print()
    console.print(table)
