"""The report of a scenario: one self-contained HTML page, and its pictures as PNG beside it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2

from scenarios.figures import comparison, detail, save
from scenarios.outputs import file_name, writing
from scenarios.panels import Flown, colour, verdict
from scenarios.run import Result
from scenarios.schema import Scenario, to_toml
from scenarios.score import Score
from scenarios.summary import Row, cells, summarise, text
from sim_bridge.faults import SURFACES
from sim_bridge.truth import write_whole

EXPLANATION = (
    "nMAE: mean over θ, φ and β of the mean absolute tracking error, divided by 20°, 20° and the larger of 1° and "
    "the magnitude of the mean β error, signs kept (a β that swings about zero is divided by 1°, a constant one by "
    "itself); of true states, until the aircraft was lost. Vs none: change of nMAE against mode none, which flies "
    "without adaptation; negative is better. Before, after: nMAE before and after a sudden fault. Sm: smoothness of "
    "the commands (eq. 16), higher (nearer to zero) is smoother. Step: largest change of a command from one sample to "
    "the next. Switches: changes of who flies. Late: samples that were not answered in time. Lost: flights in which "
    "the aircraft left the limits of attitude or altitude. Means are over the flights that were not lost."
)


def scores_by_mode(results: Sequence[Result]) -> dict[str, dict[str, Score]]:
    """Return the scores by mode and reference, in the order flown."""
    scores: dict[str, dict[str, Score]] = {}
    for result in results:
        scores.setdefault(result.job.mode.name, {})[result.job.reference.name] = result.score
    return scores


def write_report(scenario: Scenario, results: Sequence[Result], out: Path) -> Path:
    """Write ``report.html`` and its pictures into ``out``; return the page's path.

    The pictures show the first reference; the table all of them.
    """
    rows = summarise(scores_by_mode(results))
    headings, body = cells(rows)
    references = list(dict.fromkeys(r.job.reference.name for r in results))
    first = [_flown(r) for r in results if r.job.reference.name == references[0]]
    with writing(out):
        pictures = _pictures(scenario, first, references, out / "figures")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    page = environment.get_template("report.html.j2").render(
        title=scenario.title,
        description=scenario.description,
        headings=headings,
        rows=body,
        best=best_row(rows),
        explanation=EXPLANATION,
        comparison=pictures[0],
        details=pictures[1:],
        flight_headings=["mode", "reference", "nMAE %", "θ %", "φ %", "β %", "Sm rad Hz", "switches", "late", "lost"],
        flights=[_flight_row(r) for r in results] if len(references) > 1 else [],
        facts=_facts(results),
        scenario=to_toml(scenario),
        colours={row.mode: colour(row.mode) for row in rows},
    )
    path = out / "report.html"
    write_whole(path, lambda file: file.write(page.encode()))
    return path


def best_row(rows: Sequence[Row]) -> int | None:
    """Return the index of the mode that lost the fewest flights, and among those has the smallest nMAE."""
    known = [(row.lost, row.nmae, i) for i, row in enumerate(rows) if row.nmae is not None]
    return min(known)[2] if len(known) > 1 else None


def _flown(result: Result) -> Flown:
    faults = result.job.flight.faults
    named = {getattr(fault, "surface", None) for fault in faults}.union(*(getattr(f, "surfaces", ()) for f in faults))
    broken = frozenset(surface for name, surface in SURFACES.items() if name in named)
    return Flown(result.job.mode.name, result.flight, result.adaptation, result.score, broken)


def _pictures(
    scenario: Scenario, flown: Sequence[Flown], references: Sequence[str], folder: Path
) -> list[dict[str, str]]:
    """Draw the comparison and each mode; return titles and base64 PNGs, the comparison first."""
    which = f"reference {references[0]}" + (f", the first of {len(references)}" if len(references) > 1 else "")
    drawn = [("Modes side by side", "comparison", comparison(flown, scenario.title))]
    for one in flown:
        title = f"{one.mode}: {verdict(one.score)}"
        drawn.append((title, one.mode, detail(one, title)))
    pictures = []
    for title, name, figure in drawn:
        png = save(figure, folder / f"{file_name(name)}.png").read_bytes()
        pictures.append({"title": title, "png": base64.b64encode(png).decode()})
    pictures[0]["title"] += f" ({which})"
    return pictures


def _flight_row(result: Result) -> list[str]:
    score = result.score
    figures = (score.nmae, score.nmae_theta, score.nmae_phi, score.nmae_beta)
    return [
        result.job.mode.name,
        result.job.reference.name,
        *(text(value, ".2f") for value in figures),
        text(score.smoothness, ".1f"),
        text(score.switches, "d"),
        text(score.late_ticks, "d"),
        "no" if score.lost_at is None else f"at {score.lost_at:.1f} s",
    ]


def _facts(results: Sequence[Result]) -> list[tuple[str, Any]]:
    """Return what a reader needs to fly it again; no date, so that equal flights give equal pages."""
    job = results[0].job
    return [
        ("population", f"{job.population.name} ({max(len(r.adaptation.members) for r in results)} members)"),
        ("duration", f"{job.flight.duration:g} s at 100 Hz, {'real time' if job.realtime else 'lockstep'}"),
        ("references", ", ".join(dict.fromkeys(r.job.reference.name for r in results))),
        ("seeds of the bridge", ", ".join(dict.fromkeys(str(r.job.flight.seed) for r in results))),
        ("flights", len(results)),
    ]
