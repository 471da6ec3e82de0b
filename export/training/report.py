"""Score a trained run on evaluation references and write results/training.json.

``python -m export.training.report runs/serl10``
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from export.population import Population, load_run
from export.study.cases import CASES, CaseFleet, choose
from export.training.evaluate import DURATION, Scores, evaluation_references
from export.training.evaluate import score as flights_scores
from task import results
from task.errors import UserError

KNOWN = tuple(case.name for case in CASES)
TARGET = 8.0
"""Champion's nominal nMAE [%] that this population is meant to stay below."""


def score(population: Population, case: str, references: int, seed: int) -> Scores:
    """Fly every member on ``references`` evaluation references of 80 s in one case of the thesis's table 2."""
    fleet = CaseFleet(choose(case)[0])
    drawn = evaluation_references(fleet, seed, references)
    return flights_scores(population.network, fleet.fly_case(population.network, population.parameters, drawn, range(references)))


def _mean(scores: Scores, member: int) -> str:
    lost = int(scores.lost[member].sum())
    return f"{scores.nmae[member].mean():.2f}" + (f" ({lost} lost)" if lost else "")


def members_table(population: Population, scores: Scores) -> results.Table:
    """Return every member's scores, best first."""
    order = np.argsort(scores.ranking(), kind="stable")
    return results.Table(
        title="Members, nominal",
        columns=["member", "nMAE mean [%]", "worst [%]", "Sm [rad Hz]", "return of 80 s", "lost"],
        rows=[
            [
                population.description.members[i].name,
                round(float(scores.nmae[i].mean()), 2),
                round(float(scores.nmae[i].max()), 2),
                round(float(scores.smoothness[i].mean()), 1),
                round(float(scores.returns[i].mean()), 1),
                int(scores.lost[i].sum()),
            ]
            for i in order
        ],
    )


def cases_table(population: Population, scores: dict[str, Scores]) -> results.Table:
    """Return champion, population average, TD3 actor and the member that is best in each case."""
    champion = population.champion
    rows = []
    for case, case_scores in scores.items():
        best = int(np.argmin(case_scores.ranking()))
        flew = case_scores.nmae[~case_scores.lost.any(axis=1)]
        rows.append(
            [
                case,
                _mean(case_scores, champion),
                f"{flew.mean():.2f} ({len(flew)} of {len(case_scores.nmae)})" if len(flew) else "none",
                _mean(case_scores, len(case_scores.nmae) - 1),
                f"{population.description.members[best].name}: {_mean(case_scores, best)}",
            ]
        )
    columns = ["case", "champion", "average of those that lost no flight", "last member", "best member"]
    return results.Table(title="nMAE [%] by case", columns=columns, rows=rows)


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--references", type=click.IntRange(1), default=10, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the references.")
@click.option("--cases", default="nominal", show_default=True, help=f"Comma-separated, of {', '.join(KNOWN)}.")
@click.option("--name", default="training", show_default=True, help="Of the file in results/.")
def main(run: Path, references: int, seed: int, cases: str, name: str) -> None:
    """Score the trained population in RUN."""
    wanted = list(dict.fromkeys(["nominal", *cases.split(",")]))
    for case in wanted:
        if case not in KNOWN:
            raise UserError(f"--cases: no case '{case}'; expected some of {', '.join(KNOWN)}")
    began = time.perf_counter()
    population = load_run(run)
    scores = {case: score(population, case, references, seed) for case in wanted}
    nominal, champion = scores["nominal"], population.champion
    training = population.description.training
    value = float(nominal.nmae[champion].mean())
    flown = int((~nominal.lost.any(axis=1)).sum())
    claims = [
        results.Claim(
            claim=f"champion's nominal nMAE, mean of {references} references of {DURATION:g} s",
            value=round(value, 2),
            unit="%",
            target=f"< {TARGET:g}",
            holds=bool(value < TARGET and not nominal.lost[champion].any()),
        ),
        results.Claim(
            claim="champion's worst reference", value=round(float(nominal.nmae[champion].max()), 2), unit="%"
        ),
        results.Claim(claim="champion's Sm", value=round(float(nominal.smoothness[champion].mean()), 1), unit="rad Hz"),
        results.Claim(claim="members that lose no nominal flight", value=flown, unit=f"of {len(nominal.nmae)}"),
        results.Claim(claim="frames trained on", value=training.get("frames"), unit=""),
        results.Claim(claim="critic updates", value=training.get("updates"), unit=""),
        results.Claim(claim="wall time of the training", value=round(training.get("seconds", 0.0)), unit="s"),
    ]
    each = results.Table(
        title="Champion on each reference, nominal",
        columns=["reference", "nMAE [%]", "Sm [rad Hz]"],
        rows=[
            [i, round(float(nominal.nmae[champion, i]), 2), round(float(nominal.smoothness[champion, i]), 1)]
            for i in range(references)
        ],
    )
    tables = [members_table(population, nominal), each]
    if len(wanted) > 1:
        tables.append(cases_table(population, scores))
    results.write(
        name,
        results.Result(
            title=f"Training: {run.name}",
            command=f"python -m export.training.report {run} --references {references} --seed {seed} --cases {cases}",
            seconds=round(time.perf_counter() - began, 1),
            runs=references,
            seeds=[seed],
            claims=claims,
            tables=tables,
            notes=[
                "The champion was picked on other references than these.",
                "nMAE by the definition of the published experiments (task.metrics); over the flown part where lost.",
            ],
        ),
    )
    console = Console()
    for table in tables:
        shown = Table(title=table.title)
        for column in table.columns:
            shown.add_column(column, justify="right")
        for row in table.rows:
            shown.add_row(*map(str, row))
        console.print(shown)


if __name__ == "__main__":
    main()
