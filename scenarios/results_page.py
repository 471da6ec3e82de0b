"""The page of measured figures: docs/results.md from results/*.json, nothing added and nothing left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scenarios.outputs import prepare_file
from sim_bridge.truth import write_whole
from task.errors import UserError
from task.results import Claim, Result, Table, read

HEAD = """# Results

Every figure claimed in this repository, as written by the command that measured it; `understudy results` renders this
page from `results/*.json`. A figure that misses its target says so.
"""


def write_page(folder: Path, out: Path) -> int:
    """Render every result of ``folder`` to ``out``; return how many there are. Raises UserError."""
    files = sorted(folder.glob("*.json"))
    if not files:
        raise UserError(f"{folder}: no results (*.json); measure some first, as with 'make chapter8'")
    prepare_file(out)
    text = page({path.stem: read(path) for path in files}).encode()
    write_whole(out, lambda file: file.write(text))
    return len(files)


def page(results: dict[str, Result], head: str = HEAD) -> str:
    """Return the page below ``head``; equal results give equal text. Several files may have one title."""
    contents = "".join(f"- [{result.title}](#{name}) (`{name}.json`)\n" for name, result in results.items())
    return "\n".join([head, contents, *(_section(name, result) for name, result in results.items())])


def _section(name: str, result: Result) -> str:
    seeds = f", seeds {_seeds(result.seeds)}" if result.seeds else ""
    runs = f"{result.runs} run{'' if result.runs == 1 else 's'}{seeds}, {result.seconds:.0f} s"
    parts = [f'<a id="{name}"></a>\n\n## {result.title}\n\n`{result.command}` ({runs})\n']
    if result.claims:
        parts.append(_claims(result.claims))
    parts += [_table(table) for table in result.tables]
    parts += ["".join(f"- {note}\n" for note in result.notes)] if result.notes else []
    return "\n".join(parts)


def _seeds(seeds: list[int]) -> str:
    """Return seeds as a range where they are one."""
    if len(seeds) > 2 and seeds == list(range(seeds[0], seeds[-1] + 1)):
        return f"{seeds[0]} to {seeds[-1]}"
    return ", ".join(map(str, seeds))


def _claims(claims: list[Claim]) -> str:
    rows = [[c.claim, " ".join(filter(None, (number(c.value), c.unit))), c.target, _verdict(c)] for c in claims]
    return _markdown(["figure", "measured", "target", "holds"], rows)


def _verdict(claim: Claim) -> str:
    return {None: "", True: "yes", False: "**no**"}[claim.holds]


def _table(table: Table) -> str:
    return f"**{table.title}**\n\n{_markdown(table.columns, [[number(v) for v in row] for row in table.rows])}"


def number(value: Any) -> str:
    """Return a cell: floats to four significant digits, None as a dash."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return str(value)


def _markdown(columns: list[str], rows: list[list[str]]) -> str:
    def line(values: list[str]) -> str:
        return "| " + " | ".join(v.replace("|", "\\|").replace("\n", " ") for v in values) + " |\n"

    return line(columns) + line(["---"] * len(columns)) + "".join(line(row) for row in rows)
