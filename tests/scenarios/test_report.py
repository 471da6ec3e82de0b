"""The report: one page that needs nothing else, the same bytes for the same flights."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from rich.console import Console

from scenarios import figures, report, trace
from scenarios.panels import Flown, cast_colours, shade_fault
from scenarios.report import scores_by_mode, write_report
from scenarios.results_page import number, write_page
from scenarios.run import Result
from scenarios.schema import Scenario
from scenarios.screen import print_table
from scenarios.summary import summarise
from scenarios.trace import read_log, read_truth
from sim_bridge.faults import AnyFault, Crossed, Effectiveness
from task.errors import UserError
from task.results import Claim, Table, write
from task.results import Result as Measured
from task.state import ACTION


@pytest.fixture
def flights(make_result: Callable[..., Result]) -> list[Result]:
    return [
        make_result(mode, reference, lost)
        for mode, lost in (("none", 7.0), ("understudy-soft", None))
        for reference in ("evaluation-1", "evaluation-2")
    ]


def test_the_page_is_whole_and_the_same_twice(flights: list[Result], tmp_path: Path) -> None:
    scenario = Scenario(title="Wings & <ice>", description="What is to be seen.")
    page = write_report(scenario, flights, tmp_path / "a")
    text = page.read_text()
    assert text == write_report(scenario, flights, tmp_path / "b").read_text()
    assert "Wings &amp; &lt;ice&gt;" in text
    assert not re.search(r"""(src|href)=["'](?!data:)""", text)
    assert text.count("data:image/png;base64,") == 3  # side by side, and each mode
    assert "the magnitude of the mean β error" in text  # as task.metrics divides
    assert "lost at 7.0 s" in text
    assert text.count("<tr") == 3 + 5  # two modes and four flights, with their headings
    for name in ("comparison", "none", "understudy-soft"):
        assert np.ptp(imread(tmp_path / "a" / "figures" / f"{name}.png")) > 0.5  # not a blank picture


@pytest.mark.parametrize(
    ("faults", "expected"),
    [
        ((), ACTION.de),
        ((Effectiveness(start=4.0, surface="aileron", factor=-1.0),), ACTION.da),
        ((Crossed(start=4.0),), ACTION.dr),
    ],
)
def test_the_comparison_shows_a_surface_that_the_fault_names(
    make_result: Callable[..., Result],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    faults: tuple[AnyFault, ...],
    expected: ACTION,
) -> None:
    shown, draw = [], figures.deflection

    def drawn(ax: Axes, flown: Flown, surface: ACTION) -> None:
        shown.append(surface)
        draw(ax, flown, surface)

    monkeypatch.setattr(figures, "deflection", drawn)
    flown = make_result()
    flown.flight.command[:] *= [3.0, 1.0, 2.0]  # the elevator is moved most, then the rudder
    job = replace(flown.job, flight=msgspec.structs.replace(flown.job.flight, faults=faults))
    write_report(Scenario(title="t", description="d"), [replace(flown, job=job)], tmp_path)
    assert shown[0] == expected


@pytest.mark.parametrize(("name", "lines"), [("actor_{}", 1), ("actor_{}/beta_e*8+theta_e*2+phi_e*2", 2)])
def test_the_legend_of_the_cast_stays_on_the_page(
    make_result: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, lines: int
) -> None:
    pages, draw = [], figures.comparison

    def drawn(flown: list[Flown], title: str) -> Figure:
        pages.append(draw(flown, title))
        return pages[-1]

    monkeypatch.setattr(report, "comparison", drawn)
    tones = {name.format(i): f"C{i}" for i in range(6)}
    monkeypatch.setattr(figures, "cast_colours", lambda _: tones)
    monkeypatch.setattr(figures, "cast_strip", lambda *_: None)
    flown = make_result()
    write_report(Scenario(title="t", description="d"), [flown], tmp_path)
    page, legend = pages[0], pages[0].legends[-1]
    shown = legend.get_window_extent()
    assert page.bbox.x0 <= shown.x0
    assert shown.x1 <= page.bbox.x1
    assert len({round(text.get_window_extent().y0) for text in legend.get_texts()}) == lines
    assert shown.y1 <= min(ax.xaxis.label.get_window_extent().y0 for ax in page.axes[-3:])


def casts(result: Result, members: int) -> Result:
    """Return the flight as flown by one member after the other."""
    active = np.arange(len(result.adaptation.time)) * members // len(result.adaptation.time)
    names = [f"member {i}" for i in range(members)]
    return replace(result, adaptation=replace(result.adaptation, members=names, active=active))


def test_every_member_keeps_its_own_colour(make_result: Callable[..., Result], tmp_path: Path) -> None:
    flown = casts(make_result(), 24)
    tones = cast_colours([Flown("none", flown.flight, flown.adaptation, flown.score)])
    assert len(set(tones.values())) == 24
    write_report(Scenario(title="t", description="d"), [flown], tmp_path)
    picture = np.round(imread(tmp_path / "figures" / "comparison.png") * 255).astype(int)[..., :3].reshape(-1, 3)
    drawn = {f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in np.unique(picture, axis=0)}
    assert {tone.lower() for tone in tones.values()} <= drawn


def test_who_flies_alone_is_not_in_the_legend(make_result: Callable[..., Result]) -> None:
    flown = [make_result(), casts(make_result("pid"), 1)]
    shown = [Flown(one.job.mode.name, one.flight, one.adaptation, one.score) for one in flown]
    assert list(cast_colours(shown)) == ["calm", "keen"]
    assert len(figures.comparison(shown[1:], "t").legends) == 1  # no strip, nothing to say of it


def test_a_fault_that_begins_while_another_acts_is_marked(make_result: Callable[..., Result]) -> None:
    acting = np.array([[0, 0], [1, 0], [1, 0], [1, 1], [0, 1], [1, 1]], dtype=float)
    flown = make_result()
    np.savez(
        file := io.BytesIO(), time_us=np.arange(6) * 10_000, x=flown.flight.x[:6], surfaces=np.zeros((6, 3)),
        command=np.zeros((5, 3)), faults=acting,
    )  # fmt: skip
    file.seek(0)
    flight = read_truth(file, flown.flight.reference)  # type: ignore[arg-type]
    assert flight.fault_onsets() == pytest.approx([0.01, 0.03, 0.05])
    assert flown.flight.fault_onsets() == [4.0]
    panel = Figure().subplots()
    shade_fault(panel, flight)
    assert [line.get_xdata()[0] for line in panel.lines] == flight.fault_onsets()  # type: ignore[index]


def test_a_flight_lost_at_once_is_drawn_without_a_warning(make_result: Callable[..., Result], tmp_path: Path) -> None:
    write_report(Scenario(title="t"), [make_result(lost_at=0.1)], tmp_path)


def test_a_log_cut_off_within_a_cycle_is_read_to_its_last_whole_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cycle = {"timestamp": np.arange(3) * 10_000, "member": np.zeros(3)}
    innovation = {"timestamp": np.arange(2) * 10_000, "q": np.zeros(2)}
    topics = [SimpleNamespace(name="cycle", data=cycle), SimpleNamespace(name="innovation", data=innovation)]
    log = SimpleNamespace(data_list=topics, msg_info_dict={"members": '["calm"]'})
    monkeypatch.setattr(trace, "ULog", lambda file: log)
    (tmp_path / "cut.ulg").touch()
    read = read_log(tmp_path / "cut.ulg")
    assert (len(read.time), len(read.active), read.innovation.shape) == (2, 2, (2, 1))


@pytest.mark.parametrize("title", ["Shift [/] of 0.25 [m]", "costs $\\frac$ and $x_$"])
def test_a_title_is_shown_as_it_is(flights: list[Result], tmp_path: Path, title: str) -> None:
    write_report(Scenario(title=title), flights, tmp_path)
    screen = Console(file=io.StringIO(), width=160)
    print_table(screen, title, summarise(scores_by_mode(flights)))
    assert title in screen.file.getvalue()  # type: ignore[attr-defined]


def test_a_members_name_is_shown_as_it_is(make_result: Callable[..., Result], tmp_path: Path) -> None:
    made = make_result("understudy-soft")
    named = replace(made.adaptation, members=["costs $\\frac$", "a $x_$ b"])
    write_report(Scenario(title="t"), [replace(made, adaptation=named)], tmp_path)
    assert (tmp_path / "report.html").exists()


def test_the_table_on_the_terminal(flights: list[Result]) -> None:
    screen = Console(file=io.StringIO(), width=160)
    print_table(screen, "Ice", summarise(scores_by_mode(flights)))
    lines = screen.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert any(re.search(r"none\s+–", line) and line.split()[-2:] == ["2", "7.0"] for line in lines)  # both lost
    assert any(re.search(r"understudy-soft\s+1\.67", line) for line in lines)  # 1 of 20 deg on one channel of three


def test_the_results_page_says_what_misses_its_target(tmp_path: Path) -> None:
    claims = [
        Claim(claim="kept", value=1.5, unit="%", target="< 2 %", holds=True),
        Claim(claim="missed", value=2.5, unit="%", target="< 2 %", holds=False),
        Claim(claim="seen", value=None),
    ]
    table = Table(title="By mode", columns=["mode", "nMAE"], rows=[["a|b", 1.0], ["none", None]])
    measured = Measured(
        title="Chapter 8", command="make chapter8", seconds=61.2, runs=50, seeds=[1, 2, 3], claims=claims,
        tables=[table], notes=["One reference was lost."],
    )  # fmt: skip
    folder = tmp_path / "results"
    write("b", measured, folder)
    write("a", measured, folder)
    out = tmp_path / "docs" / "results.md"
    assert write_page(folder, out) == 2
    text = out.read_text()
    assert text.index("- [Chapter 8](#a) (`a.json`)") < text.index("- [Chapter 8](#b) (`b.json`)")  # told apart
    assert "| missed | 2.5 % | < 2 % | **no** |" in text
    assert "| kept | 1.5 % | < 2 % | yes |" in text
    assert "| seen | – |  |  |" in text
    assert "| a\\|b | 1 |" in text
    assert "50 runs, seeds 1 to 3, 61 s" in text
    write_page(folder, out)
    assert out.read_text() == text


def test_no_results_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no results"):
        write_page(tmp_path, tmp_path / "page.md")


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (True, "yes"), (0.000123456, "0.0001235"), (12345.6, "12346"), (7, "7"), ("as is", "as is")],
)
def test_numbers_in_tables(value: object, text: str) -> None:
    assert number(value) == text
