"""A result as plain text for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from task.results import Result, Table


def _table(table: Table) -> Iterator[str]:
    cells = [table.columns, *([str(cell) for cell in row] for row in table.rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(table.columns))]
    yield table.title
    for row in cells:
        first, *rest = row
        yield "  ".join([first.ljust(widths[0]), *(c.rjust(w) for c, w in zip(rest, widths[1:], strict=True))])
    yield ""


def show(result: Result) -> Iterator[str]:
    """Yield the lines of a result: tables, claims, notes."""
    yield f"{result.title} ({result.runs} flights, {result.seconds:g} s)"
    yield ""
    for table in result.tables:
        yield from _table(table)
    for claim in result.claims:
        verdict = "" if claim.holds is None else ("holds: " if claim.holds else "MISSED: ")
        target = f" (target {claim.target})" if claim.target else ""
        yield f"{verdict}{claim.claim}: {claim.value} {claim.unit}{target}"
    yield ""
    yield from result.notes
