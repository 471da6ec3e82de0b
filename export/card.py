"""MODEL_CARD.md: what a population is, where it comes from, what it was seen to do and what it is for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np

from export.population import Population
from export.study.cases import CASES, NOMINAL_CASE, REVERSED
from task.limits import DEFLECTION_LIMIT, DT
from task.reward import UNSAFE_ALPHA, UNSAFE_PHI

if TYPE_CHECKING:
    from export.screening import Screening

CARD = "MODEL_CARD.md"
TEMPLATE = "card.md.j2"
_LABELS = {
    "algorithm": "algorithm",
    "seed": "seed",
    "frames": "frames",
    "simulated_frames": "frames flown",
    "generations": "generations",
    "updates": "critic updates",
    "seconds": "wall time [s]",
    "device": "device",
    "threads": "threads",
    "cores": "cores of the machine",
}
"""Of what a trainer says of itself; anything else that is short is shown under its own name."""
_COPIES = {
    "/-": "`A/-ea` is A with its commands to elevator (e) and aileron (a) turned round, r stands for the rudder",
    "*": "`A/beta_e*8+r*0.5` is A that sees eight times the sideslip's error and half the yaw rate",
}
"""What a part of a name says of the member: :mod:`export.mirrors`, :mod:`export.gains`."""


def card(population: Population, name: str, versions: Mapping[str, str], screening: Screening | None) -> str:
    """Return the card's Markdown; equal populations give equal text."""
    network, description = population.network, population.description
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("export", "."), undefined=jinja2.StrictUndefined, keep_trailing_newline=True
    )
    return environment.get_template(TEMPLATE).render(
        name=name,
        members=len(description.members),
        parameters=population.parameters.shape[1],
        shape="-".join(map(str, (network.observation, *(layer.units for layer in network.layers)))),
        period_ms=f"{1000.0 * DT:g}",
        champion=description.champion,
        copies=[told for part, told in _COPIES.items() if any(part in m.name for m in description.members)],
        limit_deg=f"{np.rad2deg(DEFLECTION_LIMIT):g}",
        alpha_deg=f"{np.rad2deg(UNSAFE_ALPHA):g}",
        bank_deg=f"{np.rad2deg(UNSAFE_PHI):g}",
        provenance=provenance(description.training, versions),
        **(_screened(population, screening) if screening else {"cases": []}),
    )


def provenance(training: Mapping[str, Any], versions: Mapping[str, str]) -> dict[str, str]:
    """Return what made the population, in words; whatever it does not say of itself is not there."""
    config, teachers = training.get("config"), training.get("teachers")
    rows: dict[str, Any] = {}
    if isinstance(config, dict):
        rows["configuration"] = f"{config.get('name', 'unnamed')}; whole in the manifest, `training.config`"
    rows["teachers"] = "not stated" if teachers is None else (_listed(teachers) or "none: from scratch")
    for key, value in training.items():
        if isinstance(value, str | int | float) and not (isinstance(value, str) and len(value) > 200):
            rows[_LABELS.get(key, key)] = value
    if isinstance(made := training.get("versions"), dict):
        rows["made with"] = _pairs(made)
    rows["exported with"] = _pairs(versions)
    return {key: _cell(value) for key, value in rows.items()}


def _pairs(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in values.items())


def _listed(values: object) -> str:
    return ", ".join(map(str, values)) if isinstance(values, list | tuple) else str(values)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.4g}"
    return str(value).replace("|", "\\|").replace("\n", " ")


def _screened(population: Population, screening: Screening) -> dict[str, Any]:
    settings = screening.settings
    return {
        "references": settings.references,
        "duration": f"{settings.duration:g}",
        "unsafe": f"{100.0 * settings.unsafe:g}",
        "saturated": f"{100.0 * settings.saturated:g}",
        "error": f"{settings.error:g}",
        "flown": sum(scores.lost.shape[1] for scores in screening.scores.values()),
        "cases": _cases(population, screening),
        "rows": _members(population, screening),
        "left_out": list(population.description.training.get("screening", {}).get("left_out", ())),
    }


def _cases(population: Population, screening: Screening) -> list[list[str]]:
    """Return a row for each case: the champion, the best, the average and how many keep the constraints."""
    names = [_cell(member.name) for member in population.description.members]
    titles = {case.name: case.title for case in (*CASES, *REVERSED)}
    rows = []
    for case, scores in screening.scores.items():
        best, lost = int(np.argmin(scores.ranking())), int(scores.lost[population.champion].sum())
        average, whole = screening.average(case)
        kept = sum(not screening.breaches(i, case) for i in range(len(names)))
        champion = f"{scores.nmae[population.champion].mean():.2f}" + (f" ({lost} lost)" if lost else "")
        first = f"{names[best]}: {scores.nmae[best].mean():.2f}" if whole else "none"
        rest = f"{average:.2f} ({whole})" if whole else "none"
        rows.append([case, titles[case], champion, first, rest, f"{kept} of {len(names)}"])
    return rows


def _members(population: Population, screening: Screening) -> list[list[str]]:
    """Return a row for each member, those that keep the constraints of most cases first."""
    nominal = screening.scores[NOMINAL_CASE]
    lost = np.sum([scores.lost.sum(axis=1) for scores in screening.scores.values()], axis=0)
    ranking = nominal.ranking()
    order = sorted(range(len(ranking)), key=lambda i: (-screening.passed(i), float(ranking[i]), i))
    return [
        [
            _cell(population.description.members[i].name),
            str(screening.passed(i)),
            f"{nominal.nmae[i].mean():.2f}",
            f"{nominal.smoothness[i].mean():.1f}",
            str(int(lost[i])),
            screening.verdict(i),
        ]
        for i in order
    ]
