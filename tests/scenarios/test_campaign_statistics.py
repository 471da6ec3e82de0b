"""Paired statistics, derived rows and claims on flights made by hand."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from rich.console import Console

from scenarios.campaign.claims import claims, hindsight
from scenarios.campaign.command import result, show
from scenarios.campaign.plots import draw
from scenarios.campaign.report import tables
from scenarios.campaign.scores import NAN, Events, Record
from scenarios.campaign.statistics import (
    bound,
    interval,
    key,
    mean,
    median,
    of_oracle,
    paired,
    stalled,
    stalls,
    suited,
    survival,
    time_to_suited,
    wilson,
)
from scenarios.campaign.table import Campaign
from task.errors import UserError


def flight(row: str, index: int, nmae: float | None, member: str = "", fault: str = "elevator x -1", **more) -> Record:
    """Return a flight; without an nMAE it was lost after 2 s."""
    lost = nmae is None
    fields = {
        "suite": "hard", "fault": fault, "group": "reversal", "index": index, "half": "tuning", "moment": "level",
        "references": "evaluation", "trim": "nominal", "sensors": "ideal", "air": "still", "preview": True,
        "fault_at": 10.0, "row": row, "member": member, "survived": not lost, "lost_after": 2.0 if lost else NAN,
        "nmae": 50.0 if lost else nmae, "smoothness": -5.0, "largest_step": 1.0,
    }  # fmt: skip
    return Record(**(fields | more))


def row(name: str, *nmae: float | None, **more) -> dict:
    return {key(r): r for r in (flight(name, i, n, **more) for i, n in enumerate(nmae))}


def test_paired_changes_losses_and_shares():
    p = paired(row("a", 9.0, 10.3, 10.6, None, 5.0), row("none", 10.0, 10.0, 10.0, 10.0, None))
    assert (p.flights, p.both, p.saved, p.lost) == (5, 3, 1, 1)
    assert p.mean == pytest.approx((-10.0 + 3.0 + 6.0) / 3)
    assert (p.median, p.worst) == (pytest.approx(3.0), pytest.approx(6.0))
    assert p.of_means == pytest.approx(100.0 * (29.9 / 30.0 - 1.0))
    assert p.slightly_worse == pytest.approx(100.0 * 3 / 5)
    assert p.clearly_worse == pytest.approx(100.0 * 2 / 5)
    assert p.low <= p.mean <= p.high


def test_nothing_in_common_is_not_a_number_and_no_error():
    p = paired(row("a", None), row("none", 3.0))
    assert math.isnan(p.mean)
    assert p.slightly_worse == 100.0
    assert math.isnan(paired({}, row("none", 1.0)).clearly_worse)


def test_the_interval_is_that_of_the_mean():
    values = np.random.default_rng(1).normal(3.0, 2.0, 400)
    low, high = interval(list(values))
    assert (low, high) == pytest.approx((values.mean() - 0.196, values.mean() + 0.196), abs=0.03)
    assert interval(list(values)) == (low, high)
    assert math.isnan(interval([1.0])[0])


def test_survival_among_those_that_another_row_survives():
    ours, oracle = row("a", 1.0, None, None), row("oracle", 1.0, 1.0, None)
    assert survival(ours) == pytest.approx(100.0 / 3)
    assert survival(ours, oracle) == pytest.approx(50.0)


def test_a_suited_member_is_near_the_best_and_its_time_counts_from_the_fault():
    members = [flight("members", 0, n, m) for m, n in (("a", 1.0), ("b", 1.39), ("c", 1.41), ("d", None))]
    assert suited(members) == {"a", "b"}
    assert suited(members[3:]) == set()

    def time(*changes, nmae=1.5):
        at, to = zip(*changes, strict=True)
        return time_to_suited(flight("x", 0, nmae, switched_at=list(at), switched_to=list(to)), members)

    assert time((-10.0, "c"), (-4.0, "d"), (0.3, "c"), (0.5, "b"), (2.0, "c")) == 0.5
    assert time((-10.0, "c"), (-4.0, "a"), (1.0, "c")) == 0.0
    assert time((-10.0, "a"), (-4.0, "c")) == math.inf
    # who is told more in the cast than alone suits the flight that shows it
    assert time((-10.0, "a"), (-4.0, "c"), nmae=1.39) == 0.0
    assert time((-10.0, "c"), (0.7, "d"), nmae=1.0) == 0.7
    assert time((-10.0, "c"), (0.7, "d"), nmae=None) == math.inf
    assert time((-10.0, "c"), (0.7, "b"), (2.0, "d"), nmae=1.0) == 0.7


def campaign() -> Campaign:
    best = ["good", "mirror"]
    flown = {"good": (1.0, None, None), "mirror": (None, 1.2, 1.6), "calm": (3.0, 4.0, None)}
    records = [flight("members", i, n, m) for m, ns in flown.items() for i, n in enumerate(ns)]
    records += [
        flight("structured", i, n, switched_at=[-10.0, 0.25], switched_to=best) for i, n in enumerate((1.1, 1.3, None))
    ]
    records += [flight("pid", i, n) for i, n in enumerate((0.5, None, None))]
    return Campaign(records, "good")


def test_rows_that_follow_from_the_members():
    flown = campaign()
    assert [r.member for r in flown.pick("oracle").values()] == ["good", "mirror", "mirror"]
    assert [r.survived for r in flown.pick("none").values()] == [True, False, False]
    assert flown.robust == {"hard": "mirror"}  # two of three, as calm, and more accurate
    assert list(flown.rows) == ["none", "robust", "oracle", "structured", "pid"]
    with pytest.raises(UserError, match="--robust odd: no such member; choose from calm, good, mirror"):
        Campaign([flight("members", 0, 1.0, m) for m in ("good", "mirror", "calm")], "good", "odd")


def test_times_are_taken_where_a_change_is_asked_for():
    flown = campaign()
    assert flown.casting(flown.pick("structured")) == [0.25, 0.25]  # of the first flight the champion is the right one
    assert sorted(flown.casting(flown.pick("structured"), all_suited=True)) == [0.0, 0.25, 0.25]
    assert flown.casting(flown.pick("pid")) == []


def test_claims_are_figures_of_the_flights_and_may_fail():
    found = {c.claim: c for c in claims(campaign(), "structured", faithful=False)}
    where = "structured, hard, still air, sensors ideal"
    alive = found[f"{where}: survives of what the oracle survives"]
    assert (alive.value, alive.target, alive.holds) == (pytest.approx(66.67), ">= 98", False)
    peer = found["structured, hard, all: survival less the best peer's (robust)"]
    assert (peer.value, peer.holds) == (0.0, True)
    ratio = found[f"{where}, reversals: nMAE over the oracle's, median"]
    assert (ratio.value, ratio.holds) == (pytest.approx((1.1 + 1.3 / 1.2) / 2, rel=1e-3), True)
    against = found["structured, hard, all: mean nMAE against the oracle's, where both survive"]
    assert against.value == pytest.approx(100.0 * ((1.1 + 1.3) / (1.0 + 1.2) - 1.0), rel=1e-3)
    assert found["structured, hard, all: survives where the oracle does not"].value == 0.0
    time = "structured, reversals, still air: time to a suited member, median"
    assert found[f"{time} (0 where one flies already)"].value == 0.25
    assert found[f"{time} where none flies yet (2 of 3)"].value == 0.25
    assert found[f"{time} (0 where one flies already)"].holds
    assert claims(campaign(), "not flown", faithful=False) == []


def test_targets_are_held_against_still_air_and_stated_sensors_alone():
    levels = (("still", "ideal", 1.1), ("still", "noise", 1.2), ("light", "noise", None), ("moderate", "ideal", None),
              ("still", "twice the noise", None))  # fmt: skip
    records = []
    for i, (air, sensors, nmae) in enumerate(levels):
        records += [flight("members", i, 1.0, "good", air=air, sensors=sensors)]
        records += [flight("structured", i, nmae, air=air, sensors=sensors)]
    records += [flight("pid", i, 1.0) for i in (0, 1)]
    found = {c.claim: c for c in claims(Campaign(records, "good"), "structured", faithful=False)}

    def held(words: str) -> tuple:
        claim = found[f"structured, hard, {words}"]
        return claim.value, claim.target, claim.holds

    survives = "survives of what the oracle survives"
    assert held(f"all: {survives}") == (40.0, "", None)
    assert held(f"still air, sensors ideal: {survives}") == (100.0, ">= 98", True)
    assert held(f"still air, sensors noise: {survives}") == (100.0, ">= 97", True)
    assert held(f"still air, sensors twice the noise: {survives}") == (0.0, "", None)
    assert held("light turbulence: survival lost against still air, of what the oracle survives")[1:] == ("< 2", False)
    assert held("moderate turbulence: survival lost against still air, of what the oracle survives")[1:] == ("", None)
    assert held("all: survival less the best peer's (robust)") == (
        -60.0,
        ">= 0",
        False,
    )  # pid flew two that both survive


def test_hindsight_says_what_a_better_member_gains_without_adaptation():
    records = []
    for i, (good, calm) in enumerate(((1.0, 0.5), (1.0, 0.6), (1.0, 1.1))):
        for member, nmae in (("good", good), ("calm", calm)):
            records.append(flight("members", i, nmae, member, suite="easy"))
    found = {c.claim: c.value for c in hindsight(Campaign(records, "good"))}
    every, one = (f"in hindsight, {who}, easy, still air, sensors ideal" for who in (
        "each flight's best member", "calm throughout"))  # fmt: skip
    assert found == {
        f"{every}: mean nMAE against no adaptation": pytest.approx(-30.0),
        f"{every}: flights > 5 % worse": 0.0,
        f"{one}: mean nMAE against no adaptation": pytest.approx(-26.67),
        f"{one}: flights > 5 % worse": pytest.approx(33.33),
    }


def test_a_peer_that_holds_the_attitude_of_a_falling_aircraft_is_named():
    records = []
    for i in range(3):
        records += [flight("members", i, 5.0, "good", suite="easy"), flight("ensemble", i, 2.0, suite="easy")]
        records += [flight("pid", i, (0.1, 1.9, 2.3)[i], suite="easy", stalled=(20.0, 0.4, NAN)[i])]
    flown = Campaign(records, "good")
    found = {c.claim: c for c in claims(flown, "ensemble", faithful=False)}
    words = "ensemble, easy, still air: where a peer's mean nMAE is furthest below (pid, elevator x -1)"
    every, flying = found[words], found[f"{words}, without 1 flights of peers on a stalled wing"]
    assert (every.value, every.target, every.holds) == (pytest.approx(-28.33), ">= -10", False)
    assert (flying.value, flying.target, flying.holds) == (pytest.approx(5.0), "", None)
    assert stalls(flown.pick("pid")) == 50.0  # of two that were looked at
    assert math.isnan(stalls(flown.pick("ensemble")))


def test_a_suited_member_that_falls_is_named():
    stalls_at = (20.0, NAN)
    records = [flight("members", i, 1.0, "good", stalled=stalls_at[i]) for i in range(2)]
    records += [
        flight("ensemble", i, nmae, switched_at=[-10.0, 0.4], switched_to=["calm", to])
        for i, (nmae, to) in enumerate(((3.0, "calm"), (1.0, "good")))
    ]
    found = {c.claim: c for c in claims(Campaign(records, "good"), "ensemble", faithful=False)}
    words = "ensemble, reversals, still air: time to a suited member, worst"
    assert (found[words].value, found[words].target, found[words].holds) == ("never", "<= 1.3", False)
    flying = found[f"{words}, without 1 flights of which the best is on a stalled wing"]
    assert (flying.value, flying.target, flying.holds) == (0.4, "", None)


def test_the_oracle_may_choose_laws_too():
    records = [flight("members", i, n, "net") for i, n in enumerate((1.0, None))]
    records += [flight("pid", i, 0.5, switched_to=[]) for i in range(3)]
    with_law = Campaign(records, "net", oracle_laws=["pid"])
    assert [(r.member, r.nmae) for r in with_law.pick("oracle").values()] == [("pid", 0.5)] * 2
    assert {r.member for r in with_law.pick("robust").values()} == {"net"}
    assert [r.nmae for r in with_law.pick("pid").values()] == [0.5] * 3
    assert [r.survived for r in Campaign(records, "net").pick("oracle").values()] == [True, False]
    with pytest.raises(UserError, match="--oracle-laws indi: the oracle needs the flights"):
        Campaign(records, "net", oracle_laws=["indi"])


def test_names_are_shown_as_they_are(tmp_path):
    odd = "costs $\\frac$ [/b]"
    flown = Campaign([flight(odd, i, 5.0, fault=f"{odd} and $x_$", suite="mine") for i in range(2)], "c")
    (picture,) = draw(flown, tmp_path)
    assert picture.exists()
    information = {"population": "p", "champion": "c", "half": "tuning", "command": "x"}
    screen = Console(file=io.StringIO(), width=200)
    show(screen, result(flown, information, 1.0, odd))
    assert odd in screen.file.getvalue()


def test_who_loses_every_flight_is_told_never_to_have_cast_a_suited_member():
    members = [flight("members", 0, nmae, member) for member, nmae in (("c", None), ("good", 5.0))]
    lost = flight("ensemble", 0, None, switched_at=[-10.0], switched_to=["c"])
    every = tables(Campaign([*members, lost, flight("pid", 0, None)], "c"))[0]
    never = {line[0]: line[every.columns.index("never %")] for line in every.rows}
    assert never == {"none": "-", "robust": "-", "oracle": "-", "ensemble": 100.0, "pid": "-"}


def test_the_order_in_which_flights_were_finished_changes_no_table():
    levels = {"air": ("still", "light", "moderate"), "trim": ("nominal", "R1", "between")}
    rng = np.random.default_rng(5)
    records = [
        flight(row, i, float(rng.uniform(3.0, 9.0)), member, fault=fault, group=group,
               air=levels["air"][i % 3], trim=levels["trim"][(i // 2) % 3])
        for i in range(12)
        for fault, group in (("elevator x -1", "reversal"), ("rudder hardover", "hardover"), ("unheard of", "new"))
        for row, member in (("members", "a"), ("members", "b"), ("ensemble", ""), ("pid", ""))
    ]  # fmt: skip
    first = tables(Campaign(records, "a"))
    assert tables(Campaign(records[::-1], "a")) == first
    assert tables(Campaign([records[i] for i in rng.permutation(len(records))], "a")) == first


def test_wilsons_interval():
    assert wilson(8, 10) == pytest.approx((49.02, 94.33), abs=0.01)
    assert wilson(10, 10) == pytest.approx((72.25, 100.0), abs=0.01)
    assert math.isnan(wilson(0, 0)[0])


def test_tables_show_losing_rows_beside_winning_ones():
    by_title = {t.title: t for t in tables(campaign())}
    faults = by_title["Suite hard: survivors, median nMAE %"]
    assert faults.rows == [["elevator x -1", "1/3, 1.00", "2/3, 1.40", "3/3, 1.20", "2/3, 1.20", "1/3, 0.50"]]
    suite = by_title["Suite hard: every row"]
    ours = dict(zip(suite.columns, suite.rows[3], strict=True))
    assert (ours["row"], ours["survive of the oracle's %"], ours["suited member s"]) == (
        "structured",
        pytest.approx(66.67),
        0.25,
    )
    ratios = by_title["Suite hard: median nMAE over the oracle's, by group"]
    assert ratios.columns == ["group", "none", "robust", "structured", "pid"]
    assert ratios.rows == [[name, 1.0, 1.0, 1.09, 0.5] for name in ("reversals", "reversal")]
    against = by_title["Suite hard: change of nMAE against none, flight by flight"]
    pid = dict(zip(against.columns, against.rows[-1], strict=True))
    assert (pid["row"], pid["mean change %"], pid["neither lost"]) == ("pid", -50.0, 1)


def test_events_are_counted_against_the_runtimes_own():
    events = Events(10.0, "good")
    for line in ("9.00 s: alarm: a surface", "10.25 s: hard switch to good/-e: predicted -1.0, incumbent -9", "x"):
        events.hear(line)
    assert (events.alarms, events.switched_at, events.switched_to) == ([-1.0], [-10.0, 0.25], ["good", "good/-e"])
    events.check(1, 1)
    events.check(1, 0)
    events.hear("11.00 s: found: commands 150 ms late")
    assert events.alarms == [-1.0]
    events.hear("11.00 s: suspected: commands 150 ms late")  # does what an alarm does
    assert events.alarms == [-1.0, 1.0]
    events.alarms.pop()
    with pytest.raises(RuntimeError, match="the runtime counted"):
        events.check(2, 1)
    with pytest.raises(RuntimeError, match="the runtime counted"):
        events.check(1, 2)


def test_a_flight_is_worse_beyond_two_and_clearly_so_beyond_five_percent():
    p = paired(row("a", 101.999, 102.001, 104.999, 105.001, 98.0), row("none", *[100.0] * 5))
    assert (p.slightly_worse, p.clearly_worse) == (60.0, 20.0)
    assert (p.saved, p.lost, p.flights, p.both) == (0, 0, 5, 5)


def test_flights_that_only_one_row_flew_are_not_compared():
    ours, other = row("a", 1.0, 2.0, None), row("none", 1.0)
    p = paired(ours, other)
    assert (p.flights, p.both, p.mean, p.lost) == (1, 1, 0.0, 0)
    assert paired(other, ours).flights == 1
    assert math.isnan(p.low)
    assert survival(ours, other) == 100.0


def test_nobody_is_close_to_an_oracle_that_was_lost():
    ours, oracle = row("a", 3.0, 2.0, 9.0, None), row("oracle", 2.0, 1.0, None, 1.0)
    assert of_oracle(ours, oracle) == 1.75
    assert math.isnan(of_oracle(row("a", None), oracle))
    assert of_oracle(row("a", 3.0, 3.0), row("oracle", 2.0)) == 1.5


def test_means_and_medians_are_of_what_is_known():
    assert mean([1.0, NAN, math.inf, 4.0]) == 2.5
    assert median([1.0, NAN, math.inf, 4.0]) == 4.0
    assert median([1.0, 2.0]) == 1.5
    assert math.isnan(mean([NAN]))
    assert math.isnan(median([NAN]))


def test_the_interval_holds_the_mean_95_times_of_100():
    values = np.random.default_rng(2).normal(0.0, 1.0, 100)
    low, high = interval(list(values))
    assert high - low == pytest.approx(2 * 1.96 * values.std() / 10.0, rel=0.1)
    assert not math.isnan(interval([1.0, 2.0])[0])


def test_a_wing_was_stalled_for_longer_than_a_second():
    for seconds, was in ((1.0, False), (1.01, True), (NAN, False)):
        assert stalled(flight("a", 0, 1.0, stalled=seconds)) is was
    mixed = {key(r): r for r in (flight("a", i, n, stalled=2.0) for i, n in enumerate((1.0, None)))}
    assert stalls(mixed) == 100.0  # of the survivors


def test_suited_is_a_fifth_and_a_fifth_of_a_percent_from_the_best():
    members = [flight("members", 0, n, m) for m, n in (("a", 10.0), ("b", 12.2), ("c", 12.21))]
    assert bound(members) == pytest.approx(12.2)
    members[1].nmae = 12.19
    assert suited(members) == {"a", "b"}
    assert math.isnan(bound([]))


def test_who_flew_at_the_fault_counts_from_it_and_who_flew_before_that_does_not():
    members = [flight("members", 0, n, m) for m, n in (("a", 1.0), ("b", 9.0))]

    def time(*changes):
        at, to = zip(*changes, strict=True)
        return time_to_suited(flight("x", 0, 5.0, switched_at=list(at), switched_to=list(to)), members)

    assert time((-10.0, "a"), (0.0, "b")) == 0.0  # until the very moment
    assert time((-10.0, "a"), (-0.01, "b")) == math.inf
    assert time((-10.0, "b"), (0.0, "a")) == 0.0
    assert time((-10.0, "b"), (3.0, "a"), (4.0, "b"), (5.0, "a")) == 3.0
