"""``python -m scenarios.campaign``: faults x references x ways of adapting, flown in process, resumable."""

from __future__ import annotations

import shlex
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import click
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from runtime.population import Population, load_population
from scenarios.campaign.claims import claims, hindsight
from scenarios.campaign.design import Cell, cells
from scenarios.campaign.flying import Flyer
from scenarios.campaign.plots import draw
from scenarios.campaign.report import tables
from scenarios.campaign.rows import MEMBERS, Row, choose_rows, row_names
from scenarios.campaign.store import Journal, read_campaign, write_parquet
from scenarios.campaign.suites import HALVES, SUITES, Half, load_suite
from scenarios.campaign.table import Campaign
from scenarios.campaign.work import Done, Task, fly_all, plan
from scenarios.cli import console, default_jobs
from scenarios.outputs import claimed
from scenarios.processes import ended_as_by_ctrl_c
from scenarios.results_page import page
from sim_bridge.truth import write_whole
from task.errors import UserError
from task.files import find_population, make_folder
from task.law_names import OWN
from task.results import Result, read, write
from understudy import stopping

QUICK = ("none", "F5 elevator x 0.3", "elevator x -1", "commands 100 ms late")
"""Faults of ``--quick``: one of each kind."""
QUICK_ROWS = "members,understudy,structured,ensemble,pid,indi-rls-signfree"

HEAD = """# Campaign

What one campaign measured; `python -m scenarios.campaign` writes this page. A figure that misses its target says so.
"""

OURS = "ensemble"
"""The row that claims are about when none is named."""

SHOWN = (
    "row", "flights", "survive of the oracle's %", "95 % from", "to", "survive %", "nMAE %", "over oracle", "switches",
    "alarms", "suited member s",
)  # fmt: skip
"""Columns of the first table of a suite that the terminal shows; the report has them all."""


def chosen_cells(suites: Sequence[str], faults: tuple[str, ...], half: Half, count: int) -> list[Cell]:
    """Return the flights; ``faults``: only those of this name or group, or with it in their name.

    Raises UserError, also when only some of the words mean a fault.
    """
    found: list[Cell] = []
    for name in dict.fromkeys(suites):
        suite = load_suite(name)
        if any(cell.suite == suite.title for cell in found):
            raise UserError(f"--suite {name}: another suite is titled {suite.title!r} too; give each its own title")
        try:
            found += cells(suite, half, count)
        except UserError as error:
            raise UserError(f"--suite {name}: {error}") from None
    if not faults:
        return found
    names = {c.fault for c in found} | {c.group for c in found}

    def meant(cell: Cell, word: str) -> bool:
        return word in (cell.fault, cell.group) if word in names else word in cell.fault

    if unknown := [word for word in faults if not any(meant(c, word) for c in found)]:
        groups = ", ".join(dict.fromkeys(c.group for c in found))
        raise UserError(f"--fault {', '.join(unknown)}: no such fault; give a part of a name, or a group: {groups}")
    return [c for c in found if any(meant(c, word) for word in faults)]


def quick_faults(suites: Sequence[str]) -> tuple[str, ...]:
    """Return those of the quick campaign's faults that the suites have; all where they have none, to be told so."""
    known = {case.name for suite in suites for case in load_suite(suite).fault}
    return tuple(fault for fault in QUICK if fault in known) or QUICK


def result(campaign: Campaign, information: dict[str, str], seconds: float, ours: str) -> Result:
    """Return the result file of a campaign."""
    faithful = "serl50" in information["population"]
    return Result(
        title=f"The campaign: {information['population']}, half '{information['half']}'",
        command=information["command"],
        seconds=round(seconds, 1),
        runs=campaign.flown,
        seeds=[],
        claims=[claim for row in words(ours) for claim in claims(campaign, row, faithful)]
        + (hindsight(campaign) if faithful else []),
        tables=tables(campaign),
        notes=[
            "Every row flies the same references, faults, noise and air. Figures are taken from the moment of the "
            "fault to the end of the flight of 40 s, also where there is no fault; those of lost flights are left out, "
            "and the loss is counted.",
            _derived(campaign),
            "A suited member survives with at most 1.2 times the oracle's nMAE plus 0.2 points; its time counts from "
            "the fault to the first change of the cast to such a member, or to the last change of a flight that is "
            "itself as good: laws in a cast are told what they do not know alone.",
            "Laws: gains tuned for the Citation (docs/laws.md). A row that is called after one flies it alone, as a "
            "peer of the cast; in rows of presets that name laws, as ensemble does, these are members of the cast.",
        ],
    )  # fmt: skip


def _derived(campaign: Campaign) -> str:
    """Return what the rows are that follow from the flights of the members."""
    if not campaign.members:
        return "none: the champion throughout."
    laws = f", the laws {', '.join(campaign.oracle_laws)} among them" * bool(campaign.oracle_laws)
    robust = ", ".join(f"{suite}: {member}" for suite, member in sorted(campaign.robust.items()))
    return (
        f"none: the champion throughout. robust: the one member that is best over the suite ({robust}), found on "
        f"these very flights. oracle: of each flight the best member in hindsight{laws}. Members fly from the "
        "moment of the fault on, until then the champion does."
    )


@click.command()
@click.option("--suite", "suites", multiple=True, help="easy, hard, or a .toml file; may be repeated.  [default: both]")
@click.option("--fault", "faults", multiple=True, help="Only faults whose name contains this, or of this group.")
@click.option("--half", type=click.Choice(HALVES), default="reported", show_default=True,
              help="Which of two disjoint halves is flown.")  # fmt: skip
@click.option("--references", "count", type=click.IntRange(1, 999), default=30, show_default=True,
              help="Flights of every fault; more later go on from these.")  # fmt: skip
@click.option("--population", default="citation", show_default=True, help="Folder of the cast, or its name.")
@click.option("--rows", help=f"Comma-separated, of: {', '.join(row_names())}, or {OWN} of a law of your own.  "
              "[default: all that imagine in the runtime's model]")  # fmt: skip
@click.option(
    "--row", "extra", multiple=True, help="One more row: NAME=PRESET[,key=value...] or NAME=LAW; may be repeated."
)
@click.option("--ours", help=f"Comma-separated rows that the claims are about.  [default: {OURS}]")
@click.option("--robust", default="", help="The member of the row 'robust'.  [default: the best in hindsight]")
@click.option("--oracle-laws", "laws", default="",
              help="Comma-separated rows that the oracle may choose besides the members: pid, indi, ...")  # fmt: skip
@click.option("--quick", is_flag=True, help="A few minutes: four faults, six rows, two references of each.")
@click.option("--jobs", type=click.IntRange(1, 64), help="Processes.  [default: 2]")
@click.option("--out", type=Path, help="Where flights and report go.  [default: flights/campaign/POPULATION-HALF]")
@click.option("--name", default="campaign", show_default=True, help="Of the files that are written.")
@click.option("--results", type=Path, help="Also write NAME.json and NAME.parquet into this folder.")
@click.option("--figures", type=Path, help="Write the figures NAME_SUITE.png into this folder.  [default: OUT]")
@click.option("--any-version", is_flag=True, help="Take flights that another version of the program flew.")
@click.option("--read", "parquet", type=Path, help="Fly nothing: report on this file of flights.")
def main(
    suites: tuple[str, ...], faults: tuple[str, ...], half: Half, count: int, population: str, rows: str | None,
    extra: tuple[str, ...], ours: str | None, robust: str, laws: str, quick: bool, jobs: int | None, out: Path | None,
    name: str, results: Path | None, figures: Path | None, any_version: bool, parquet: Path | None,
) -> None:  # fmt: skip
    """Fly the campaign, or what of it was not flown yet; write flights (Parquet), tables and figures."""
    screen = console()
    if not name or Path(name).name != name:
        raise UserError(f"--name {name}: expected the beginning of a file's name, without a folder")
    if parquet is not None:
        stored = read_campaign(parquet)
        records, information, where = stored.records, stored.information, out or parquet.parent
        check_folders(where, results, figures)
        spent = read(file).seconds if (file := parquet.with_suffix(".json")).exists() else 0.0
        flown_with = information["command"]
        ours, robust = ours or said(flown_with, "--ours") or OURS, robust or said(flown_with, "--robust")
        laws = laws or said(flown_with, "--oracle-laws")
    else:
        ours = ours or OURS
        command = command_line({
            "--suite": suites, "--fault": faults, "--half": half, "--references": str(count),
            "--population": population, "--rows": rows or (), "--row": extra, "--ours": ours, "--robust": robust or (),
            "--oracle-laws": laws or (), "--name": name if name != "campaign" else (),
        }) + " --quick" * quick  # fmt: skip
        if quick:
            faults, rows, count = faults or quick_faults(suites or SUITES), rows or QUICK_ROWS, min(count, 2)
        folder = find_population(population)
        cast = load_population(folder)
        chosen = choose_rows(rows, extra)
        check_rows(chosen, cast)
        check_names(ours, robust, laws, chosen, cast.members)
        tasks = plan(chosen_cells(suites or SUITES, faults, half, count), chosen)
        where = out or Path("flights/campaign") / f"{folder.name}-{half}"
        check_folders(where, results, figures)
        jobs = jobs or default_jobs(realtime=False)
        with claimed(where), stopping(f"what was flown is kept in {where}, the same command goes on"):
            done = fly(tasks, folder, cast.sha256, where, jobs, any_version, screen)
        spent = sum(d.seconds for d in done) / jobs
        information = {
            "population": cast.name, "sha256": cast.sha256, "champion": cast.manifest.champion, "half": half,
            "command": command,
        }  # fmt: skip
        # What is reported is what the file holds: read again, it gives the same figures.
        file = write_parquet([r for d in done for r in d.records], where / f"{name}.parquet", information)
        records = read_campaign(file).records
        screen.print("[dim]" + escape(cost(done)) + "[/]")
    campaign = Campaign(records, information["champion"], robust, words(laws))
    check_ours(ours, campaign.rows)
    found = result(campaign, information, spent, ours)
    write(name, found, where)
    report = page({name: found}, HEAD).encode()
    write_whole(where / "report.md", lambda file: file.write(report))
    pictures = draw(campaign, figures or where, name)
    if results is not None:
        write(name, found, results)
        write_parquet(records, results / f"{name}.parquet", information)
    show(screen, found)
    screen.print(escape(f"{len(records)} flights: {parquet or where / f'{name}.parquet'}"))
    screen.print(escape(f"Report: {where / 'report.md'}\nFigures: " + ", ".join(map(str, pictures))))


def said(command: str, option: str) -> str:
    """Return what a command line says of an option; nothing where it does not name it."""
    parts = shlex.split(command)
    return parts[parts.index(option) + 1] if option in parts[:-1] else ""


def words(text: str) -> list[str]:
    """Return the words of a comma-separated list."""
    return [word.strip() for word in text.split(",") if word.strip()]


def check_rows(rows: Sequence[Row | Literal["members"]], cast: Population) -> None:
    """Raise UserError unless the population has what all rows ask of it."""
    with Flyer(cast) as flyer:
        for row in rows:
            if isinstance(row, Row):
                try:
                    flyer.check(row)
                except UserError as error:
                    raise UserError(f"row {row.name}: {error}") from None


def check_ours(ours: str, rows: Iterable[str]) -> None:
    """Raise UserError when one of the rows that claims are about is none."""
    known = [name for name in dict.fromkeys([*row_names(), *rows]) if name != MEMBERS]
    if unknown := [word for word in words(ours) if word not in known]:
        raise UserError(f"--ours {ours}: unknown row {unknown[0]!r}; choose from {', '.join(known)}")


def check_names(
    ours: str, robust: str, laws: str, rows: Sequence[Row | Literal["members"]], members: Sequence[str]
) -> None:
    """Raise UserError when an option names a row or a member that will not have flown."""
    flown = [row if isinstance(row, str) else row.name for row in rows]
    check_ours(ours, flown)
    for law in words(laws):
        if law not in flown or MEMBERS not in flown:
            raise UserError(
                f"--oracle-laws {law}: the oracle needs the flights of this row and those of the members; "
                f"give --rows members,{law}"
            )
    if robust and robust not in (choices := [*members, *words(laws)]):
        raise UserError(f"--robust {robust}: no such member; choose from {', '.join(choices)}")


def check_folders(out: Path, results: Path | None, figures: Path | None) -> None:
    """Make the folders that files go to; raise UserError when that cannot be."""
    for option, folder in (("--out", out), ("--results", results), ("--figures", figures)):
        if folder is not None:
            make_folder(folder, option)


def command_line(options: dict[str, str | tuple[str, ...]]) -> str:
    """Return the command that measures the same again."""
    words = ["python -m scenarios.campaign"]
    for name, value in options.items():
        words += [f"{name} {shlex.quote(v)}" for v in ((value,) if isinstance(value, str) else value)]
    return " ".join(words)


def fly(
    tasks: Sequence[Task], population: Path, sha256: str, where: Path, jobs: int, any_version: bool, screen: Console
) -> list[Done]:
    """Fly what was not flown yet, with a bar. Raises UserError; KeyboardInterrupt after Ctrl-C, SIGTERM or SIGHUP."""
    done = []
    with ended_as_by_ctrl_c(), Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TimeRemainingColumn(), console=screen, disable=not screen.is_terminal,
    ) as progress:  # fmt: skip
        bar = progress.add_task(where.name, total=len(tasks))
        for one in fly_all(tasks, population, sha256, Journal(where / "journal.jsonl"), jobs, any_version):
            done.append(one)
            progress.advance(bar)
            if not screen.is_terminal and (at := 20 * len(done) // len(tasks)) > 20 * (len(done) - 1) // len(tasks):
                left = progress.tasks[bar].time_remaining
                screen.print(f"{5 * at} %" + (f", {left / 60.0:.0f} min left" if left else ""))
    return done


def cost(done: Sequence[Done]) -> str:
    """Return what a flight took in each row, in words; that of the members is the mean of all of them."""
    spent: dict[str, list[float]] = {}
    for one in done:
        spent.setdefault(one.task.row_name, []).append(one.seconds / len(one.records))
    return "seconds a flight: " + ", ".join(f"{name} {statistics.fmean(s):.2f}" for name, s in spent.items())


def show(screen: Console, found: Result) -> None:
    """Print the claims and the tables by suite."""
    for table in found.tables:
        if table.title.endswith("every row"):
            shown = Table(title=escape(table.title), title_justify="left", box=None, header_style="dim")
            places = [table.columns.index(name) for name in SHOWN]
            for i in places:
                shown.add_column(table.columns[i], justify="left" if i == 0 else "right")
            for row in table.rows:
                shown.add_row(*(escape(str(row[i])) for i in places))
            screen.print(shown)
    for claim in found.claims:
        verdict = {True: "holds", False: "does not hold", None: ""}[claim.holds]
        screen.print(f"{escape(claim.claim)}: {claim.value} {claim.unit}  [dim]{claim.target}[/] {verdict}")
