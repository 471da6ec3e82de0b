"""The documents: links lead somewhere, tables say what the code says, figures are the measured ones, scripts run."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest

from export.population import load_run
from runtime.cli import main as runtime
from runtime.config import Adaptation, Operation
from scenarios.results_page import page
from scenarios.schema import available, load_scenario
from sim_bridge import faults
from sim_bridge.cli import bridge
from sim_bridge.fault import Condition
from task.results import read
from task.state import STATE

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted(ROOT.glob("populations/*/MODEL_CARD.md"))]
LINK = re.compile(r"\]\(([^)\s]+)\)")
PATH = re.compile(r"`((?:task|runtime|sim_bridge|export|scenarios|bench|populations|docs|tests)/[\w./-]+)`")
TIMEOUT = 60.0


def anchors(text: str) -> set[str]:
    """Return the anchors of a page: those of its headings, as GitHub makes them, and its own."""
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", prose, flags=re.MULTILINE)
    slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    return slugs | set(re.findall(r'<a id="([^"]+)">', text))


def broken(text: str, folder: Path) -> list[str]:
    """Return the links of a page in ``folder`` that lead nowhere."""
    found = []
    for target in LINK.findall(re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        name, _, anchor = target.partition("#")
        if re.match(r"\w+:", name):
            continue
        file = folder / name if name else None
        if (file and not file.exists()) or (anchor and anchor not in anchors(file.read_text() if file else text)):
            found.append(target)
    return found


def test_a_link_that_leads_nowhere_is_found(tmp_path):
    (tmp_path / "b.md").write_text('# One two\n\n<a id="own"></a>\n')
    good = "# Top: a, b\n[x](b.md) [y](b.md#one-two) [z](b.md#own) [w](#top-a-b) [v](https://example.org/x)"
    assert broken(good, tmp_path) == []
    assert broken("# Top\n[x](c.md) [y](b.md#three) [z](#bottom)", tmp_path) == ["c.md", "b.md#three", "#bottom"]


@pytest.mark.parametrize("document", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(document):
    assert broken(document.read_text(), document.parent) == []


WRITTEN = [path for path in PAGES if path.name != "results.md"]
"""Not the page of results, whose commands name what they make."""


@pytest.mark.parametrize("document", WRITTEN, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_file_that_is_named_is_there(document):
    made = {"populations/mine", "populations/NAME"}
    assert [p for p in PATH.findall(document.read_text()) if p not in made and not (ROOT / p).exists()] == []


def section(text: str, title: str) -> str:
    """Return what stands below a heading, up to the next one."""
    return re.split(r"^#+ ", text.split(f"# {title}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


@pytest.mark.parametrize(("title", "command"), [("Options", runtime), ("The aircraft beside it", bridge)])
def test_operations_lists_every_option(title, command):
    rows = re.findall(r"^\| (`[^|]+`) \|", section((ROOT / "docs/operations.md").read_text(), title), re.MULTILINE)
    listed = set(re.findall(r"`(--[\w-]+)", " ".join(rows)))
    assert listed == {o for p in command.params if isinstance(p, click.Option) for o in p.opts}


def test_every_parameter_of_the_runtime_is_in_a_table():
    tables = "\n".join(
        line
        for name in ("adaptation.md", "operations.md")
        for line in (ROOT / "docs" / name).read_text().splitlines()
        if line.startswith("| `")
    )
    listed = {key for line in tables.splitlines() for key in re.findall(r"`(\w+)`", line.split("|")[1])}
    assert {*Adaptation.__struct_fields__, *Operation.__struct_fields__} - listed == set()


def test_the_defaults_of_the_other_keys_are_those_of_the_code():
    table = section((ROOT / "docs/operations.md").read_text(), "Other keys")
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \|", table, re.MULTILINE)
    assert len(rows) > 10
    for key, default in rows:
        have = getattr(Adaptation() if key in Adaptation.__struct_fields__ else Operation(), key)
        said = default.split()[0].strip("`")
        same = float(said) == have if isinstance(have, float) else said == str(have).lower()
        assert same, f"{key}: {default}, {have}"


def test_the_results_page_is_that_of_the_results():
    results = {path.stem: read(path) for path in sorted((ROOT / "results").glob("*.json"))}
    assert (ROOT / "docs/results.md").read_text() == page(results)


ROWS = {
    "**`ensemble`**: one cast of 26 networks and the protected law": "ensemble",
    "INDI with sign-free RLS, protected": "indi-rls-protected",
    "INDI with sign-free RLS": "indi-rls-signfree",
    "`ensemble` without identification": "ensemble-frozen",
    "INDI": "indi",
    "PID": "pid",
    "the one network that is best over the suite, chosen in hindsight": "robust",
    "main member alone, no adaptation": "none",
}


def test_the_campaign_in_the_readme_is_the_measured_one():
    tables = {t.title: t for t in read(ROOT / "results/campaign.json").tables}
    measured = {}
    for suite in ("hard", "easy"):
        table = tables[f"Suite {suite}: every row"]
        measured[suite] = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    lines = {}
    for line in (ROOT / "README.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 5 and cells[0] in ROWS:
            lines[cells[0]] = [cell.replace("**", "") for cell in cells[1:]]
    assert lines.keys() == ROWS.keys()
    for name, cells in lines.items():
        hard, easy = measured["hard"][ROWS[name]], measured["easy"][ROWS[name]]
        lost = round(easy["flights"] * (1.0 - 0.01 * easy["survive %"]))
        said = [float(cell.split()[0]) for cell in cells]
        found = [hard["survive of the oracle's %"], hard["nMAE %"], lost, easy["nMAE %"]]
        np.testing.assert_allclose(said, found, atol=0.0501)


def blocks(language: str) -> list[str]:
    """Return the code of docs/own.md in a language."""
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / "docs/own.md").read_text(), flags=re.DOTALL)


def script(mark: str) -> str:
    """Return the one script that contains ``mark``."""
    (found,) = [block for block in blocks("python") if mark in block]
    return found


@pytest.fixture
def place(tmp_path):
    """Return a folder with a reference, and the address of a free port."""
    (tmp_path / "reference.csv").write_text("t,theta,phi,beta\n0,0,0,0\n2,0.05,0.1,0\n")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return tmp_path, probe.getsockname()[1]


def together(folder: Path, first: list[str], second: list[str]) -> str:
    """Run two commands side by side until both have ended well; return what the first said."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    running = [
        subprocess.Popen(
            [sys.executable, *command], cwd=folder, env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )
        for command in (first, second)
    ]  # fmt: skip
    try:
        said = [process.communicate(timeout=TIMEOUT)[0] for process in running]
    finally:
        for process in running:
            process.kill()
            process.wait()
    assert [process.returncode for process in running] == [0, 0], said
    return said[0]


def test_the_scenario_of_ones_own_is_read(tmp_path):
    (text,) = blocks("toml")
    (tmp_path / "mine.toml").write_text(text)
    assert len(load_scenario(tmp_path / "mine.toml").flight.faults) == 2
    assert f"all {len(available())} scenarios" in (ROOT / "README.md").read_text()


def test_the_fault_in_the_readme_is_read(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    (tmp_path / "mine.toml").write_text('title = "x"\n' + text)
    assert load_scenario(tmp_path / "mine.toml").flight.faults[0].factor == -1.0


def test_the_policy_of_ones_own_is_saved(tmp_path):
    command, environment = [sys.executable, "-c", script("save_run(")], os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run(command, cwd=tmp_path, env=environment, check=True)
    assert load_run(tmp_path / "runs/mine").parameters.shape == (2, 179)


@pytest.mark.parametrize("how", ["script", "command"])
def test_the_law_of_ones_own_tracks(place, how):
    folder, port = place
    (folder / "my_law.py").write_text(script("class MyLaw"))
    (folder / "fly_mine.py").write_text(script('load_solo("my_law:MyLaw")').replace("14560", str(port)))
    (folder / "fast.toml").write_text("pitch = 1.5\n")
    command = ["-m", "runtime", "--link", f"udpin:127.0.0.1:{port}", "--law", "my_law:MyLaw@fast.toml"]
    command += ["--reference", "reference.csv", "--log", "mine.ulg"]
    flight = ["-m", "sim_bridge", "--link", f"udpout:127.0.0.1:{port}", "--duration", "12"]
    assert "flying" in together(folder, ["fly_mine.py"] if how == "script" else command, flight)
    x = np.load(folder / "truth.npz")["x"][-1]
    np.testing.assert_allclose(x[[STATE.theta, STATE.phi, STATE.beta]], [0.05, 0.1, 0.0], atol=0.08)
    assert json.loads((folder / "mine.summary.json").read_text())["outcome"] == "over"


def test_the_aircraft_of_ones_own_is_flown(place):
    folder, port = place
    (folder / "my_aircraft.py").write_text(script("plant.reset(").replace("14560", str(port)))
    flying = ["-m", "runtime", "--link", f"udpin:127.0.0.1:{port}", "--population", str(ROOT / "populations/citation")]
    said = together(folder, [*flying, "--preset", "ensemble", "--reference", "reference.csv"], ["my_aircraft.py"])
    assert "flight over after 10.0 s; 1000 cycles" in said


def test_the_kind_of_fault_of_ones_own_acts():
    names = dict(vars(faults))
    exec(script("class RollBias"), names)
    condition = Condition()
    names["RollBias"](bias=0.1).apply(condition, 0.5)
    assert condition.bias == {int(STATE.phi): 0.05}
