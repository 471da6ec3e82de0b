"""Flights of the campaign on the plant: deterministic, the runtime's own, and resumed as if never stopped."""

from __future__ import annotations

import ast
import errno
import itertools
import math
import sys
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from runtime.config import Operation
from runtime.guard import UNUSABLE, Guard
from runtime.laws.catalogue import LAWS
from runtime.population import BehaviouralPolicy, load_population
from scenarios.campaign import command, work
from scenarios.campaign.command import main
from scenarios.campaign.design import cells, reference_rows
from scenarios.campaign.flying import Flyer
from scenarios.campaign.members import Members
from scenarios.campaign.rows import Row, choose_rows, parse_row
from scenarios.campaign.scores import STALL, Events, score
from scenarios.campaign.store import Entry, Journal, plain, read_campaign, read_parquet, write_parquet
from scenarios.campaign.suites import load_suite
from scenarios.campaign.trace import Trace
from scenarios.campaign.work import LAW_SOURCES, Task, code_hash, code_of, fly_all, own_code, plan
from scenarios.outputs import LOCK, claimed
from sim_bridge.faults import SensorBias
from sim_bridge.plant import Plant
from sim_bridge.world import World
from task.errors import UserError
from task.limits import DT
from task.metrics import smoothness
from task.reward import terminated
from task.state import STATE

SECONDS = 14.0
"""Of these flights [s]; the fault comes between 8 and 12 s."""


def short(fault: str, suite: str = "hard", **wanted):
    """Return the first flight of a fault with these conditions, cut to some seconds."""
    found = (c for c in cells(load_suite(suite), "tuning", 30) if c.fault == fault)
    cell = next(c for c in found if all(getattr(c, name) == value for name, value in wanted.items()))
    return msgspec.structs.replace(cell, flight=msgspec.structs.replace(cell.flight, duration=SECONDS))


CALM = {"trim": "nominal", "air": "still"}
REVERSED = short("elevator x -1", sensors="noise", **CALM)
ROUGH = short("F5 elevator x 0.3", "easy", air="light", trim="nominal")
NOT_FLOWN = {"understudy.py", *(f"scenarios/campaign/{name}.py" for name in ("alone", "members", "rows", "suites"))}
"""Imported by what flies, but what they decide is in a task's key or in another hash."""
OWN_LAW = """
from runtime.laws.law import Law
class Mine(Law):
    def steer(self, x, reference):
        self._action[0] = self.trim(self.pressure_ratio(x.tolist())) + 0.5 * x[1] + x[7] - reference[0]
        return self._action
"""
STRUCTURED = Row(name="structured", preset="structured")


def test_a_member_alone_flies_as_the_runtime_does_bit_by_bit(cast):
    with Flyer(load_population(cast)) as flyer:
        for cell in (REVERSED, ROUGH):
            runtime = plain(flyer.fly(cell, Row(name="none", changes=("switch=none",))))
            alone = plain(flyer.fly_members(cell)[0])
            for ours in ("row", "member", "switched_at", "switched_to"):
                runtime.pop(ours, None)
                alone.pop(ours, None)
            assert alone == runtime
    assert alone["survived"]


@pytest.mark.parametrize("law", LAWS)
def test_a_law_alone_flies_as_the_runtime_does_bit_by_bit(cast, law):
    garbage = SensorBias(start=ROUGH.fault_at + 0.5, end=ROUGH.fault_at + 0.6, signal="h", bias=1e5)
    held = msgspec.structs.replace(ROUGH, flight=msgspec.structs.replace(ROUGH.flight, faults=(garbage,)))
    row = Row(name=law, law=law)
    with Flyer(load_population(cast)) as flyer:
        for cell in (REVERSED, ROUGH, held):
            assert plain(flyer.fly(cell, row)) == plain(flyer.fly_session(cell, row))


def test_a_law_of_ones_own_flies_a_row_and_is_flown_again_when_it_has_changed(cast, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    place = tmp_path / "law_of_a_row.py"
    place.write_text(OWN_LAW)
    row = parse_row("mine=law_of_a_row:Mine")
    mixed = parse_row("mixed=ensemble,laws=['law_of_a_row:Mine'],first=law_of_a_row:Mine")
    with Flyer(load_population(cast)) as flyer:
        flyer.check(row)
        with pytest.raises(UserError, match=r"law law_of_a_row:Mine: linear\(\) is not implemented"):
            flyer.check(mixed)
        flown = flyer.fly(ROUGH, row)
        assert flown.row == "mine"
        assert plain(flown) == plain(flyer.fly_session(ROUGH, row))
    before = [code_of(Task(ROUGH, one)) for one in (row, mixed)]
    assert code_of(Task(ROUGH, Row(name="pid", law="pid"))) == code_hash(LAW_SOURCES) != before[0]
    place.write_text(OWN_LAW + "# changed\n")
    own_code.cache_clear()
    assert not {code_of(Task(ROUGH, one)) for one in (row, mixed)} & set(before)


def slowly(cell, population, member):
    """Fly one member alone with nothing shared and nothing left out, every sample past the last gate."""
    world, policy, guard = World(cell.flight), BehaviouralPolicy(population), Guard(Operation())
    rows = reference_rows(cell, float(world.x[STATE.theta]))
    x, command = [], []
    for k, reference in enumerate(rows):
        if terminated(world.x):
            break
        who = member if k >= round(cell.fault_at / DT) else population.champion
        np.copyto(policy.parameters, population.parameters[who])
        unusable = guard.check_state(world.measured) & UNUSABLE
        given = guard.fallback() if unusable else guard.command(policy.steer(world.measured, reference))
        x.append(world.x.copy())
        command.append(given[0].copy())
        world.step(command[-1])
    trace = Trace(np.array(x), np.array(command), rows)
    return score(cell, "members", population.members[member], trace, Events(cell.fault_at, ""))


def test_members_fly_together_as_each_alone(cast):
    garbage = SensorBias(start=ROUGH.fault_at + 0.5, end=ROUGH.fault_at + 0.6, signal="h", bias=1e5)
    unbelieved = msgspec.structs.replace(ROUGH.flight, faults=(*ROUGH.flight.faults, garbage))
    held = msgspec.structs.replace(ROUGH, flight=unbelieved)
    early = msgspec.structs.replace(ROUGH, flight=REVERSED.flight, fault_at=SECONDS - 1.0)
    population = load_population(cast)
    members, lost = Members(population, Plant()), 0
    for cell, only in ((REVERSED, None), (held, [1]), (early, [3])):
        together = members.fly(cell, only)
        alone = [slowly(cell, population, m) for m in only or range(len(together))]
        assert [plain(r) for r in together] == [plain(r) for r in alone]
        lost += sum(not r.survived for r in together)
    assert lost >= 7
    assert members.fly(held, [0])[0].nmae != members.fly(ROUGH, [0])[0].nmae


def test_a_wing_is_stalled_beyond_the_tables_from_the_fault_on():
    first, ticks = round(REVERSED.fault_at / DT), round(SECONDS / DT)
    x, rows = np.zeros((ticks, len(STATE))), np.zeros((ticks, 3))
    x[first - 50 : first + 130, STATE.alpha] = STALL + 0.001  # half a second of it before the fault
    x[-40:, STATE.alpha] = STALL - 0.001
    flown = score(REVERSED, "none", "", Trace(x, np.zeros((ticks, 3)), rows), Events(REVERSED.fault_at, ""))
    assert flown.survived
    assert flown.stalled == pytest.approx(1.3)


def test_flights_do_not_depend_on_those_before(cast):
    with Flyer(load_population(cast)) as flyer:
        first = [flyer.fly(cell, STRUCTURED) for cell in (REVERSED, ROUGH)]
        again = [flyer.fly(cell, STRUCTURED) for cell in (ROUGH, REVERSED)]
    assert [plain(r) for r in first] == [plain(r) for r in reversed(again)]
    reversed_, _ = first
    assert reversed_.survived
    assert reversed_.switched_to[-1] == "good/-e"
    assert 0.0 < reversed_.switched_at[-1] < 1.5
    assert reversed_.alarms >= 1


def test_the_right_mirror_saves_what_the_champion_loses_and_so_does_a_mirrored_pid(cast):
    with Flyer(load_population(cast)) as flyer:
        by_member = {r.member: r for r in flyer.fly_members(REVERSED)}
        pid, mirrored = (flyer.fly(REVERSED, Row(name=law, law=law)) for law in ("pid", "pid-mirrored"))
    good = {name for name, r in by_member.items() if r.survived and r.nmae < 10.0}
    assert good == {"good/-e", "good/-er"}  # this law hardly uses the rudder
    assert not by_member["good"].survived
    assert 0.0 < by_member["good"].lost_after < SECONDS - REVERSED.fault_at
    assert not pid.survived
    assert mirrored.survived


def test_a_campaign_that_was_killed_goes_on_to_the_same_file(cast, tmp_path):
    sha256 = load_population(cast).sha256
    tasks = plan([REVERSED], [Row(name="pid", law="pid"), Row(name="indi", law="indi"), "members"])

    def fly(folder, most=99, jobs=1):
        flights = fly_all(tasks, cast, sha256, Journal(folder / "journal.jsonl"), jobs)
        return list(itertools.islice(flights, most))

    def file(folder, done):
        return write_parquet([r for d in done for r in d.records], folder / "c.parquet", {"half": "tuning"})

    whole = fly(tmp_path / "whole", jobs=2)
    begun = fly(tmp_path / "killed", 1)
    with (tmp_path / "killed" / "journal.jsonl").open("ab") as journal:
        journal.write(b'{"key": "torn by the ki')
    resumed = fly(tmp_path / "killed")
    assert [d.reused for d in resumed] == [True] * (len(begun)) + [False] * (len(tasks) - len(begun))
    assert all(d.reused for d in fly(tmp_path / "killed"))
    ours = file(tmp_path / "killed", resumed)
    assert ours.read_bytes() == file(tmp_path / "whole", whole).read_bytes()
    stored = read_parquet(ours)
    assert len(stored.records) == 2 + 8
    assert {r.member for r in stored.records if r.row == "members"} >= {"good", "good/-e", "good/-ear"}


def test_a_file_from_before_a_column_was_added_is_read_and_a_foreign_one_refused(tmp_path):
    record = score(REVERSED, "none", "", Trace(np.zeros((5, 12)), np.zeros((5, 3)), np.zeros((5, 3))), Events(0.0, ""))
    whole = write_parquet(
        [msgspec.structs.replace(record, stalled=2.0)], tmp_path / "whole.parquet", {"half": "tuning"}
    )
    assert read_parquet(whole).records[0].stalled == 2.0
    table = pq.read_table(whole)
    pq.write_table(table.drop_columns(["stalled"]), tmp_path / "older.parquet")
    older = read_parquet(tmp_path / "older.parquet")
    assert math.isnan(older.records[0].stalled)
    assert (older.records[0].fault, older.information) == (record.fault, {"half": "tuning"})
    for name, foreign in (("less", table.drop_columns(["fault"])), ("more", table.append_column("x", table["nmae"]))):
        pq.write_table(foreign, tmp_path / f"{name}.parquet")
        with pytest.raises(UserError, match=f"{name}.parquet: not flights of this campaign: its columns are suite, "):
            read_parquet(tmp_path / f"{name}.parquet")


def test_a_time_that_is_just_in_time_is_still_so_when_it_is_read_again(tmp_path):
    record = score(REVERSED, "none", "", Trace(np.zeros((5, 12)), np.zeros((5, 3)), np.zeros((5, 3))), Events(0.0, ""))
    times = [-9.37, 0.4, 1.3]
    written = msgspec.structs.replace(record, alarm=0.38, switched_at=times, switched_to=["a", "b", "a"], fault_at=9.37)
    path = write_parquet([written], tmp_path / "c.parquet", {"half": "tuning"})
    (read,) = read_parquet(path).records
    assert (read.alarm, read.switched_at, read.switched_to, read.fault_at) == (0.38, times, ["a", "b", "a"], 9.37)
    assert write_parquet([read], tmp_path / "again.parquet", {"half": "tuning"}).read_bytes() == path.read_bytes()


def test_a_full_disk_is_said_in_one_line_and_what_was_there_stays(tmp_path, monkeypatch):
    entry = Entry(key="k", code="c", seconds=1.0, records=[])
    journal = Journal(Path("/dev/full"))
    with pytest.raises(UserError, match=r"/dev/full: cannot be written: No space left.*give the command again"):
        journal.write(entry)
    kept = write_parquet([], tmp_path / "c.parquet", {"half": "tuning"})
    before = kept.read_bytes()

    def full(table, where, **_):
        where.write(b"PAR1")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    with pytest.raises(UserError, match=r"c\.parquet: cannot be written: No space left"):
        write_parquet([], kept, {"half": "reported"})
    assert [path.name for path in tmp_path.iterdir()] == ["c.parquet"]
    assert kept.read_bytes() == before


def _imported(path: Path) -> set[str]:
    """Return the modules of this program that a file imports, as paths below its root."""
    found = (node.module for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom))
    places = {f"{(name or '').replace('.', '/')}.py" for name in found}
    return {place for place in places if (work.ROOT / place).is_file()}


@pytest.mark.parametrize(
    ("sources", "left_out"),
    [
        # Of the configuration the last gate's times are asked for; what a manifest says is in the population's hash.
        (work.MEMBER_SOURCES, {"runtime/config.py", "runtime/manifest.py"}),
        # Constants and types; of the estimator laws use the recursive least squares alone.
        (work.LAW_SOURCES, {"runtime/config.py", "runtime/hypotheses.py", "runtime/plays.py"}),
        (work.PERFECT_SOURCES, set()),
    ],
)
def test_what_decides_a_flight_is_asked_for_when_it_is_resumed(sources, left_out):
    def covered(place: str) -> bool:
        return any(place == source or place.startswith(f"{source}/") for source in sources)

    files = {
        file
        for source in sources
        for file in ((work.ROOT / source).rglob("*.py") if (work.ROOT / source).is_dir() else [work.ROOT / source])
        if file.name != "identification.py" or sources is not work.LAW_SOURCES
    }
    needed = {place for file in files for place in _imported(file)} - NOT_FLOWN
    assert {place for place in needed if not covered(place)} == left_out


def test_a_row_in_the_aircraft_itself_is_flown_again_when_the_perfect_model_changes():
    perfect = Task(ROUGH, Row(name="p", preset="ensemble", model="aircraft"))
    assert work.code_of(perfect) == work.code_hash(work.PERFECT_SOURCES) != work.code_of(Task(ROUGH, STRUCTURED))


def test_an_older_record_that_lacks_what_is_asked_now_is_flown_again(cast, tmp_path):
    task, journal = Task(ROUGH, Row(name="pid", law="pid")), Journal(tmp_path / "j.jsonl")
    journal.write(Entry(key=task.key(""), code="old", seconds=1.0, records=[{"suite": "easy"}]))
    (done,) = fly_all([task], cast, "", journal, jobs=1, any_version=True)
    assert not done.reused
    assert [d.reused for d in fly_all([task], cast, "", journal, jobs=1)] == [True]


def test_a_flight_that_fails_is_named_and_the_others_are_kept(cast, tmp_path):
    tasks = [Task(ROUGH, Row(name="odd", preset="odd")), Task(ROUGH, Row(name="pid", law="pid"))]
    journal = Journal(tmp_path / "j.jsonl")
    with pytest.raises(UserError, match=r"1 of 2 tasks failed.*odd, F5 elevator x 0.3/"):
        list(fly_all(tasks, cast, "", journal, jobs=1))
    assert len(journal.read()) == 1


def test_the_command_flies_reports_and_reads_its_own_file(cast, tmp_path):
    usual = ["--population", str(cast), "--half", "tuning", "--fault", "F2", "--references", "1", "--jobs", "1"]
    out = ["--out", str(tmp_path / "out"), "--results", str(tmp_path / "results")]
    done = CliRunner().invoke(main, [*usual, *out, "--rows", "none,pid"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    names = {"campaign.json", "campaign.parquet", "campaign_easy.png", "journal.jsonl", "report.md", LOCK}
    assert {p.name for p in (tmp_path / "out").iterdir()} == names
    report = (tmp_path / "out" / "report.md").read_text()
    assert report.startswith("# Campaign\n")
    assert "robust" not in report  # nobody flew as a member
    assert "Suite easy: every row" in report
    assert "--fault F2 --half tuning" in report
    again = ["--read", str(tmp_path / "results" / "campaign.parquet"), "--out", str(tmp_path / "again")]
    done = CliRunner().invoke(main, again, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "again" / "report.md").read_text() == report


def test_a_file_is_read_with_what_it_was_flown_with(tmp_path):
    record = score(REVERSED, "none", "", Trace(np.zeros((5, 12)), np.zeros((5, 3)), np.zeros((5, 3))), Events(0.0, ""))
    flown = [
        msgspec.structs.replace(record, row=row, member=member, nmae=nmae, survived=True, stalled=0.0)
        for row, member, nmae in (("members", "c", 9.0), ("members", "d", 8.0), ("pid", "", 5.0), ("indi", "", 6.0))
    ]
    command = "python -m scenarios.campaign --ours indi --robust c --oracle-laws pid"
    file = write_parquet(
        flown, tmp_path / "c.parquet", {"population": "p", "champion": "c", "half": "tuning", "command": command}
    )

    def report(*options):
        done = CliRunner().invoke(main, ["--read", str(file), *options], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return (tmp_path / "report.md").read_text()

    as_flown = report()
    assert "(hard: c), found" in as_flown
    assert "in hindsight, the laws pid among them" in as_flown
    assert "| indi, hard, all: survives" in as_flown
    other = report("--ours", "pid", "--robust", "d", "--oracle-laws", "pid,indi")
    assert "(hard: d), found" in other
    assert "the laws pid, indi among them" in other
    assert "| pid, hard, all: survives" in other


def test_two_campaigns_do_not_fly_into_one_folder(cast, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "fly", lambda *_: pytest.fail("flown"))
    options = ["--population", str(cast), "--fault", "F2", "--rows", "pid", "--out", str(tmp_path)]
    with claimed(tmp_path), pytest.raises(UserError, match="another command flies there now"):
        CliRunner().invoke(main, options, catch_exceptions=False)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"names": "pdi", "extra": ()}, "--rows pdi: unknown row 'pdi'; choose from none"),
        ({"names": ",", "extra": ()}, "--rows ,: expected at least one row; choose from none, robust, oracle, members"),
        ({"names": "pid", "extra": ("fast",)}, "--row fast: expected NAME=PRESET"),
        (
            {"names": "pid", "extra": ("fast=ensemble,horizon=inf",)},
            r"expected `float` <= 60\.0 \[s\].*horizon",
        ),
        ({"names": "pid", "extra": ("fast=structured,settel=1",)}, "--set settel: unknown key"),
        ({"names": "pid", "extra": ("pid=structured",)}, "--row pid: there is a row of this name"),
    ],
)
def test_a_wrong_row_is_answered_in_one_line(arguments, said):
    with pytest.raises(UserError, match=said):
        choose_rows(**arguments)


def test_a_row_may_hold_a_list():
    row = parse_row("slow=structured,delays=[0.1,0.2],settle=0.05")
    assert row.changes == ("delays=[0.1,0.2]", "settle=0.05")
    assert row.configuration(True).adaptation.delays == (0.1, 0.2)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--ours", "typo"], "--ours typo: unknown row 'typo'; choose from none"),
        (["--oracle-laws", "typo"], "--oracle-laws typo: the oracle needs the flights of this row"),
        (["--rows", "members,pid", "--robust", "typo"], "--robust typo: no such member; choose from good"),
        (["--row", "odd=ensemble,first=typo"], "row odd: first: expected one of"),
        (["--name", "a/b"], "--name a/b: expected the beginning of a file's name"),
        (["--out", "/proc/x"], "--out: /proc/x: cannot be written"),
        (["--results", "/proc/x"], "--results: /proc/x: cannot be written"),
        (["--figures", "/proc/x"], "--figures: /proc/x: cannot be written"),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_flown(cast, tmp_path, arguments, said, monkeypatch):
    monkeypatch.setattr(command, "fly", lambda *_: pytest.fail("flown"))
    usual = ["--population", str(cast), "--half", "tuning", "--fault", "F2", "--references", "1", "--rows", "pid"]
    done = CliRunner().invoke(main, [*usual, "--out", str(tmp_path / "out"), *arguments])
    assert isinstance(done.exception, UserError)
    assert str(done.exception).startswith(said)


def test_a_file_that_is_none_of_a_campaign_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"nope\.parquet: no such file"):
        read_campaign(tmp_path / "nope.parquet")
    information = {"population": "p", "champion": "c", "half": "tuning", "command": "x"}
    bare = write_parquet([], tmp_path / "bare.parquet", {"population": "p"})
    with pytest.raises(UserError, match="it does not say its champion, half, command"):
        read_campaign(bare)
    with pytest.raises(UserError, match="holds no flights"):
        read_campaign(write_parquet([], tmp_path / "empty.parquet", information))


def scored(ticks, rows=SECONDS, events=None, x=(), command=None):
    """Return the figures of a flight at zero with some states changed: (samples, signal, value)."""
    total = round(rows / DT)
    states, commands = np.zeros((ticks, len(STATE))), np.zeros((ticks, 3))
    for samples, signal, value in x:
        states[samples, signal] = value
    trace = Trace(states, commands if command is None else command, np.zeros((total, 3)))
    return score(REVERSED, "none", "", trace, events or Events(REVERSED.fault_at, "good"))


FIRST, TICKS = round(REVERSED.fault_at / DT), round(SECONDS / DT)


def test_figures_are_taken_from_the_moment_of_the_fault_on():
    before, after = slice(0, FIRST), slice(FIRST, None)
    flown = scored(TICKS, x=[(before, STATE.theta, 1.0), (before, STATE.alpha, 1.0), (before, STATE.phi, 1.0)])
    assert (flown.nmae, flown.nmae_theta, flown.nmae_phi, flown.stalled) == (0.0, 0.0, 0.0, 0.0)
    flown = scored(TICKS, x=[(after, STATE.theta, np.radians(2.0)), (after, STATE.phi, -np.radians(4.0))])
    assert (flown.nmae_theta, flown.nmae_phi, flown.nmae_beta) == (pytest.approx(10.0), pytest.approx(20.0), 0.0)
    assert flown.nmae == pytest.approx(10.0)
    flown = scored(TICKS, x=[(after, STATE.beta, np.radians(0.5))])
    assert (flown.nmae_beta, flown.beta_deg) == (pytest.approx(50.0), pytest.approx(0.5))


def test_the_step_of_the_command_at_the_fault_counts_and_none_before_it():
    command = np.zeros((TICKS, 3))
    command[: FIRST - 10] = np.radians(9.0)
    command[FIRST:, 1] = np.radians(2.0)
    flown = scored(TICKS, command=command)
    assert flown.largest_step == pytest.approx(2.0)
    assert flown.smoothness == smoothness(command[FIRST - 1 :])


def test_a_flight_is_lost_when_it_ends_before_its_reference_and_after_so_many_seconds():
    flown = scored(TICKS)
    assert flown.survived
    assert np.isnan(flown.lost_after)
    flown = scored(FIRST + 123)
    assert not flown.survived
    assert flown.lost_after == pytest.approx(1.23)
    early = scored(FIRST - 200)
    assert early.lost_after == pytest.approx(-2.0)
    assert np.isnan([early.nmae, early.smoothness, early.largest_step, early.stalled]).all()
    assert np.isnan(scored(FIRST).nmae)
    assert scored(FIRST + 1).nmae == 0.0


def test_switches_and_alarms_are_counted_on_either_side_of_the_fault():
    events, at = Events(REVERSED.fault_at, "good"), REVERSED.fault_at
    for since, line in (
        (-2.0, "soft switch to calm: predicted"), (-1.0, "alarm: the aircraft"), (0.0, "alarm: the aircraft"),
        (0.0, "hard switch to good/-e: predicted"), (0.5, "suspected: commands late"), (1.5, "soft switch to good: x"),
    ):  # fmt: skip
        events.hear(f"{at + since:.2f} s: {line}")
    flown = scored(TICKS, events=events)
    assert (flown.switches, flown.switches_before) == (2, 1)
    assert (flown.alarms, flown.alarms_before, flown.alarm) == (2, 1, 0.0)
    assert flown.switched_at == [round(-at, 2), -2.0, 0.0, 1.5]
    assert flown.switched_to == ["good", "calm", "good/-e", "good"]
    nobody = scored(TICKS, events=Events(at, ""))
    assert (nobody.switched_at, nobody.switched_to, nobody.switches, nobody.switches_before) == ([], [], 0, 0)
    assert np.isnan(nobody.alarm)


def test_what_came_when_the_aircraft_was_lost_or_later_is_forgotten():
    events = Events(10.0, "good")
    for at in (9.0, 12.0, 13.0):
        events.hear(f"{at:.2f} s: alarm: the aircraft")
        events.hear(f"{at:.2f} s: soft switch to member{at:.0f}: predicted")
    events.end(12.0)
    assert events.alarms == [-1.0]
    assert (events.switched_at, events.switched_to) == ([-10.0, -1.0], ["good", "member9"])
    events.end(0.0)
    assert (events.switched_at, events.switched_to) == ([-10.0], ["good"])
