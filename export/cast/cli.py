"""``python -m export.cast``: breed candidates, choose the cast, write a trained run."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from export.cast.breed import Breeder
from export.cast.choose import tune, write
from export.cast.config import config_path, load
from task.config import read_bytes
from task.files import atomic
from understudy import stopping

MORE = 3
"""Exit code when the minutes are over and there is more to do."""


class _Interrupt:
    """The first Ctrl-C ends the run after this round; the second at once. A budget of minutes does the same."""

    def __init__(self, minutes: float | None) -> None:
        self._end = time.monotonic() + 60.0 * minutes if minutes is not None else None
        self.asked = False
        signal.signal(signal.SIGINT, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        click.echo("breed: stopping after this round; once more to stop at once", err=True)

    def __call__(self) -> bool:
        return self.asked or (self._end is not None and time.monotonic() > self._end)


@click.group()
def main() -> None:
    """The default cast: policies bred case by case and chosen for coverage."""


@main.command()
@click.option("--config", default="citation", show_default=True, help="A shipped configuration's name, or a .toml.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The run's folder; resumed when it exists.")
@click.option("--minutes", type=click.FloatRange(0.0), help="Begin nothing after so many minutes; run again to go on.")
@stopping("the same command goes on")
def breed(config: str, out: Path, minutes: float | None) -> None:
    """Breed a cast into the folder OUT, a trained run that 'understudy export' takes.

    Three stages: search for each case, comparison of all candidates, choice. What is finished is kept, and the same
    command goes on.
    """
    breeder = Breeder(load(config), out)
    text = read_bytes(config_path(config), "cast configuration")  # it may be the run's own, which is then left as it is
    with atomic(out / "config.toml") as file:
        file.write(text)
    stop = _Interrupt(minutes)
    console = Console()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        searches = progress.add_task("searches", total=len(list(breeder.plan())), completed=len(breeder.bred))
        ended = breeder.breed(_reporter(progress, searches, lambda: len(breeder.bred)), stop)
        if ended:
            comparing = progress.add_task("comparison", total=len(breeder.cases))
            done = iter(range(1, len(breeder.cases) + 1))
            ended = tune(breeder, _reporter(progress, comparing, lambda: next(done)), stop)
    if not ended:
        if stop.asked:
            raise KeyboardInterrupt
        click.echo("stopped; the same command goes on")
        sys.exit(MORE)
    chosen = write(breeder)
    click.echo(f"{out}: {len(chosen.members)} members, {chosen.needed} of them needed to cover the cases")
    if chosen.uncovered:
        click.echo(f"not covered: {', '.join(chosen.uncovered)}")


def _reporter(progress: Progress, task: TaskID, completed: Callable[[], int]) -> Callable[[str, bool], None]:
    """Return what shows a line: passing ones beside the bar, final ones above it."""

    def report(line: str, final: bool) -> None:
        if final:
            progress.console.print(line, highlight=False)
            progress.update(task, completed=completed(), description=line.split(":")[0])
        else:
            progress.update(task, description=line)

    return report
