"""The tables of a campaign: by suite, by fault, by condition, and without a fault."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from scenarios.campaign.design import DURATION
from scenarios.campaign.rows import DERIVED, MEMBERS, NONE, ORACLE
from scenarios.campaign.scores import Record
from scenarios.campaign.statistics import Key, alive, mean, median, of_oracle, paired, stalls, survival, wilson
from scenarios.campaign.suites import places
from scenarios.campaign.table import Campaign
from task.results import Table

REVERSALS = ("reversal", "second reversal", "reversal with latency")
"""Groups in which a surface works backwards and nothing else is broken but time."""
STEADY_SIDESLIP = ("hardover", "jam", "engine")
"""Groups of faults that leave a constant sideslip."""
SLICES = ("sensors", "air", "trim", "moment", "references", "preview")
"""Factors that survival is also shown by."""


def short(value: float | None, digits: int = 4) -> Any:
    """Return a figure as tables show it; a dash for what is not known, words for never."""
    if value is None or math.isnan(value):
        return "-"
    if math.isinf(value):
        return "never"
    return float(f"{value:.{digits}g}")


def rows_of(campaign: Campaign) -> list[str]:
    """Return the rows that tables show, in order."""
    return [row for row in campaign.rows if row != MEMBERS]


def suite_table(campaign: Campaign, suite: str) -> Table:
    """Return one row for each way of adapting over a whole suite."""
    columns = [
        "row", "flights", "survive of the oracle's %", "95 % from", "to", "survive %", "95 % from", "to",
        "nMAE %", "theta %", "phi %", "|beta| deg", "over oracle",
        "stalled %", "Sm rad Hz", "largest step deg", "switches", "alarms", "suited member s", "worst s", "never %",
    ]  # fmt: skip
    oracle = campaign.pick(ORACLE, suite)
    body = []
    for row in rows_of(campaign):
        flights = campaign.pick(row, suite)
        if not flights:
            continue
        kept = [r for r in flights.values() if r.survived]
        times = campaign.casting(flights)
        known = [t for t in times if math.isfinite(t)]
        body.append([
            row, len(flights), *rate(flights, oracle), *rate(flights),
            *(short(mean([getattr(r, name) for r in kept])) for name in ("nmae", "nmae_theta", "nmae_phi", "beta_deg")),
            short(of_oracle(flights, oracle), 3), short(stalls(flights), 3),
            short(median([r.smoothness for r in kept]), 3),
            short(max((r.largest_step for r in kept), default=math.nan), 3),
            *(short(mean([getattr(r, what) for r in flights.values()]), 3) for what in ("switches", "alarms")),
            short(median(known), 3), short(max(known, default=math.nan), 3),
            short(100.0 * (len(times) - len(known)) / len(times) if times else math.nan, 3),
        ])  # fmt: skip
    return Table(title=f"Suite {suite}: every row", columns=columns, rows=body)


def rate(flights: Mapping[Key, Record], among: Mapping[Key, Record] | None = None) -> list[Any]:
    """Return survival with its 95 % interval [%], of all flights or of those that ``among`` survived."""
    return [short(v) for v in (survival(flights, among), *wilson(*alive(flights, among)))]


def oracle_table(campaign: Campaign, suite: str) -> Table:
    """Return the median nMAE over the oracle's, over what both survive: reversals, all others, then every group."""
    rows, oracle = [row for row in rows_of(campaign) if row != ORACLE], campaign.pick(ORACLE, suite)
    groups = list(dict.fromkeys(r.group for r in oracle.values()))
    others = [g for g in groups if g not in REVERSALS]
    body = []
    for name, wanted in (("reversals", REVERSALS), ("others", others), *((g, (g,)) for g in groups)):
        picked = [by_group(campaign, row, suite, wanted) for row in rows]
        if oracle and any(picked):
            body.append([name, *(short(of_oracle(flights, oracle), 3) for flights in picked)])
    return Table(title=f"Suite {suite}: median nMAE over the oracle's, by group", columns=["group", *rows], rows=body)


def paired_table(campaign: Campaign, suite: str, against: str) -> Table:
    """Return how every row compares with one of them, flight by flight."""
    columns = [
        "row", "flights", "neither lost", "mean change %", "95 % from", "to", "median %", "worst %",
        "mean nMAE changes %", "> 2 % worse, % of flights", "> 5 % worse, % of flights", "saved", "lost",
    ]  # fmt: skip
    other = campaign.pick(against, suite)
    body = []
    for row in rows_of(campaign):
        if row == against or not (flights := campaign.pick(row, suite)):
            continue
        p = paired(flights, other)
        body.append([
            row, p.flights, p.both, *(short(v, 3) for v in (p.mean, p.low, p.high, p.median, p.worst, p.of_means)),
            short(p.slightly_worse, 3), short(p.clearly_worse, 3), p.saved, p.lost,
        ])  # fmt: skip
    return Table(title=f"Suite {suite}: change of nMAE against {against}, flight by flight", columns=columns, rows=body)


def fault_table(campaign: Campaign, suite: str) -> Table:
    """Return survival and median nMAE of every fault and row; survivors out of all, then their median [%]."""
    rows = rows_of(campaign)
    body = [
        [fault, *(cell(list(campaign.pick(row, suite, fault=fault).values())) for row in rows)]
        for fault in faults_of(campaign, suite)
    ]
    return Table(title=f"Suite {suite}: survivors, median nMAE %", columns=["fault", *rows], rows=body)


def cell(flights: Sequence[Record]) -> str:
    """Return survivors out of all and their median nMAE [%]."""
    if not flights:
        return "-"
    kept = [r for r in flights if r.survived]
    how = f", {median([r.nmae for r in kept]):.2f}" if kept else ""
    return f"{len(kept)}/{len(flights)}{how}"


def sideslip_table(campaign: Campaign, suite: str) -> Table:
    """Return attitude and sideslip apart where constant sideslip, divided by itself, makes a floor of 33 %."""
    rows = rows_of(campaign)
    body = []
    for fault in faults_of(campaign, suite):
        picked = {row: campaign.pick(row, suite, fault=fault).values() for row in rows}
        if any(r.group in STEADY_SIDESLIP or r.fault.startswith("F6") for flights in picked.values() for r in flights):
            kept = {row: [r for r in flights if r.survived] for row, flights in picked.items()}
            body.append([
                fault, *(
                    f"{median([0.5 * (r.nmae_theta + r.nmae_phi) for r in k]):.2f}, "
                    f"{median([r.beta_deg for r in k]):.1f}" if k else "-" for k in kept.values()
                ),
            ])  # fmt: skip
    return Table(
        title=f"Suite {suite}: medians of survivors, nMAE % of theta and phi alone, mean |beta| deg",
        columns=["fault", *rows], rows=body,
    )  # fmt: skip


def faults_of(campaign: Campaign, suite: str) -> list[str]:
    """Return the faults of a suite that were flown, in the order of its file; of an unknown suite, by group."""
    found = {(r.group, r.fault) for row in campaign.rows.values() for r in row.values() if r.suite == suite}
    place = places(suite)
    return [fault for _, _, fault in sorted((place.get(fault, len(place)), group, fault) for group, fault in found)]


def slice_table(campaign: Campaign, suite: str) -> Table:
    """Return survival among the flights that the oracle survives, by level of each factor [%]."""
    rows = rows_of(campaign)
    oracle = campaign.pick(ORACLE, suite)
    body = []
    for factor in SLICES:
        for level in campaign.levels(factor):
            picked = {row: campaign.pick(row, suite, **{factor: level}) for row in rows}
            if any(picked.values()):
                body.append([factor, str(level), *(short(survival(p, oracle), 3) for p in picked.values())])
    return Table(
        title=f"Suite {suite}: survival % of what the oracle survives, by condition",
        columns=["factor", "level", *rows], rows=body,
    )  # fmt: skip


def quiet_table(campaign: Campaign) -> Table:
    """Return alarms and switches of flights without a fault, by air, and what they did to the nMAE."""
    body = []
    none = healthy(campaign, NONE)
    for row in rows_of(campaign):
        for air in campaign.levels("air"):
            flights = {k: r for k, r in healthy(campaign, row).items() if r.air == air}
            if not flights:
                continue
            minutes = len(flights) * DURATION / 60.0
            alarms = sum(r.alarms + r.alarms_before for r in flights.values())
            switches = sum(r.switches + r.switches_before for r in flights.values())
            p = paired(flights, none)
            body.append([
                row, str(air), short(minutes, 3), alarms, short(10.0 * alarms / minutes, 3), switches,
                short(survival(flights)), short(p.of_means, 3), short(p.worst, 3),
            ])  # fmt: skip
    columns = [
        "row", "air", "minutes", "alarms", "alarms in 10 min", "switches", "survive %",
        "nMAE against none %", "worst %",
    ]  # fmt: skip
    return Table(title="Flights without a fault", columns=columns, rows=body)


def healthy(campaign: Campaign, row: str) -> dict[Key, Record]:
    """Return the flights without a fault of a row, those of R1 and R2 among them."""
    return {
        k: r for k, r in campaign.rows.get(row, {}).items() if r.group == "none" or r.fault.startswith(("R1", "R2"))
    }


def tables(campaign: Campaign) -> list[Table]:
    """Return all tables of a campaign."""
    found = []
    for suite in campaign.suites:
        found.append(suite_table(campaign, suite))
        found.append(oracle_table(campaign, suite))
        found += [paired_table(campaign, suite, row) for row in DERIVED if row in campaign.rows]
        found += [fault_table(campaign, suite), sideslip_table(campaign, suite), slice_table(campaign, suite)]
    found.append(quiet_table(campaign))
    return [table for table in found if table.rows]


def by_group(campaign: Campaign, row: str, suite: str, groups: Sequence[str]) -> dict[Key, Record]:
    """Return the flights of a row in some groups of a suite."""
    return {k: r for k, r in campaign.pick(row, suite).items() if r.group in groups}
