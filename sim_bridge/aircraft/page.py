"""The measured part of docs/aircraft.md, written from results/aircraft.json."""

from __future__ import annotations

from pathlib import Path

from task.errors import UserError
from task.results import Result, Table

PAGE = Path("docs") / "aircraft.md"
BEGIN, END = "<!-- measured: begin -->\n", "<!-- measured: end -->\n"


def _table(table: Table) -> str:
    lines = [f"**{table.title}**", "", "| " + " | ".join(table.columns) + " |", "|---" * len(table.columns) + "|"]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in table.rows]
    return "\n".join(lines)


def measured(result: Result) -> str:
    """Return the measured part: tables, the claims that fall short or are only reported, notes."""
    held = sum(claim.holds is True for claim in result.claims)
    judged = sum(claim.holds is not None for claim in result.claims)
    lines = [f"`{result.command}`: {result.runs} flights of 20 s, {held} of {judged} targets hold."]
    lines += [_table(table) for table in result.tables]
    rest = [claim for claim in result.claims if not claim.holds]
    lines.append(
        "\n".join(f"- {claim.claim}: {claim.value} {claim.unit} {claim.target}".rstrip(" -") for claim in rest)
    )
    lines.append("\n".join(f"- {note}" for note in result.notes))
    return "\n\n".join(lines) + "\n"


def replace(text: str, result: Result) -> str:
    """Return a page's text with its measured part renewed; raise UserError when the marks are gone."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise UserError(f"{PAGE}: no {BEGIN.strip()} .. {END.strip()}; put the two lines where the tables belong")
    return before + begin + "\n" + measured(result) + "\n" + end + after
