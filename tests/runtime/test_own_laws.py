"""Laws of one's own: by module and class, with their settings, and what is wrong with one in one line."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

from runtime.cli import _configure, _describe, _load
from runtime.laws.catalogue import load_settings, load_solo, make_law
from runtime.population import load_population
from runtime.presets import resolve
from runtime.reference import RecordedReference
from runtime.session import Session
from task.errors import UserError
from task.law_names import LAWS, own_digest, own_law, why_no_law
from task.reference import base_reference
from task.state import STATE

ROOT = Path(__file__).parents[2]
ROWS = base_reference(6.0, 0.056)
HEAD = "import numpy as np\nfrom runtime.laws.law import Law\nfrom task.config import Settings\n"


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Return what writes a module into the working directory, each under a name of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    made = []

    def write(text, name=""):
        name = name or f"law_{tmp_path.name}_{len(made)}".replace("-", "_")
        made.append(name)
        (tmp_path / f"{name}.py").write_text(text)
        return name

    yield write
    for name in made:
        sys.modules.pop(name, None)


def documented():
    (found,) = re.findall(
        r"```python\n(import numpy.*?class MyLaw.*?)```", (ROOT / "docs/own.md").read_text(), re.DOTALL
    )
    return found


def law(body, extra=""):
    return f"{HEAD}{extra}\nclass Mine(Law):\n" + "\n".join(f"    {line}" for line in body.splitlines())


STEER = "def steer(self, x, reference):\n    return "


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("import nothing_of_the_kind", "needs nothing_of_the_kind, which is not installed"),
        ("x = 1 / 0", "cannot be imported: ZeroDivisionError: division by zero"),
        ("x = (", "cannot be imported: SyntaxError: "),
        ("raise SystemExit(3)", "cannot be imported: SystemExit: 3"),
        (HEAD + "class Other(Law):\n    pass\n", r"no class Mine in .*\.py; laws there: Other"),
        ("class Mine:\n    pass\n", r"expected a subclass of runtime\.laws\.law\.Law, got <class"),
        ("Mine = 3", r"expected a subclass of runtime\.laws\.law\.Law, got 3"),
        (law("pass"), r"steer\(x, reference\) is not implemented"),
        (law("def __init__(self, gains):\n    pass"), r"expected Mine\(airframe, dt\), got Mine\(gains\): too many"),
        (law("def __init__(self, airframe, dt):\n    pass\n" + STEER + "x[:3]"), r"does not call super\(\).__init__"),
        (law("def __init__(self, airframe, dt):\n    raise OSError('no gains')"), "cannot be made: OSError: no gains"),
        (law(STEER + "[0.0, 0.0, 0.0]"), r"steer: expected an array \(3,\) of finite floats \[rad\], got list"),
        (law(STEER + "np.zeros(4)"), r"steer: expected an array \(3,\) .*, got shape \(4,\)"),
        (law(STEER + "np.zeros(3, dtype=int)"), r"steer: .*, got dtype int64"),
        (law(STEER + "np.array([0.0, np.nan, 0.0])"), r"steer: .*, got \[0\.0, nan, 0\.0\]"),
        (law(STEER + "x[99]"), "fails at a state of level flight: IndexError"),
        (law("def steer(self, x, reference):\n    x[0] = 1.0\n    return x[:3]"), "ValueError: .*read-only"),
        (law("settings = 3\n" + STEER + "x[:3]"), r"Mine\.settings: expected a subclass of task\.config\.Settings"),
        (
            law("settings = Gains\n" + STEER + "x[:3]", "class Gains(Settings):\n    k: float = 1.0\n"),
            r"expected Mine\(airframe, dt, settings\), got Mine\(airframe: ",
        ),
        (
            law("settings = Gains\n" + STEER + "x[:3]", "class Gains(Settings):\n    k: float\n"),
            "settings: object missing required field `k`",
        ),
    ],
)
def test_what_is_wrong_with_a_law_is_one_line(module, text, line):
    name = f"{module(text)}:Mine"
    with pytest.raises(UserError, match=line) as caught:
        load_solo(name)
    assert str(caught.value).startswith(f"law {name}: ")
    assert "\n" not in str(caught.value)


def test_a_law_that_is_nowhere_is_said_with_where_was_looked(module, tmp_path):
    with pytest.raises(UserError, match=f"law no_such:Mine: no module no_such, .*{tmp_path}.* nor installed"):
        make_law("no_such:Mine", load_settings())
    with pytest.raises(UserError, match="no module no_such"):
        own_digest("no_such:Mine")


@pytest.mark.parametrize("name", ["lqr", "my_law:", ":MyLaw", "my law:MyLaw", "my_law:MyLaw@fast.json", "a:B@x,y.toml"])
def test_what_is_no_name_of_a_law_is_said(name):
    assert own_law(name) is None
    for done in (lambda: make_law(name, load_settings()), lambda: resolve("ensemble", overrides=(f'laws=["{name}"]',))):
        with pytest.raises(UserError, match=f"expected one of {', '.join(LAWS)}, or MODULE:CLASS of your own, got"):
            done()
    assert not any(map(why_no_law, LAWS))


def test_settings_are_the_defaults_or_those_of_a_file(module, tmp_path):
    name = f"{module(documented())}:MyLaw"
    (tmp_path / "fast.toml").write_text("pitch = 2.0\n")
    x = np.zeros(12)
    x[STATE.V], x[STATE.h] = 90.0, 2000.0
    asked = np.array([0.1, 0.0, 0.0])
    slow, fast = (load_solo(f"{name}{which}") for which in ("", "@fast.toml"))
    ratio = slow.law.pressure_ratio(x.tolist())
    steered = [float(one.law.steer(x, asked)[0]) for one in (slow, fast)]
    assert steered[1] - steered[0] == pytest.approx(-0.1 / ratio)
    assert (slow.name, fast.members) == (name, [f"{name}@fast.toml"])
    digests = {slow.sha256, fast.sha256}
    (tmp_path / "fast.toml").write_text("pitch = 3.0\n")
    digests.add(load_solo(f"{name}@fast.toml").sha256)
    assert len(digests) == 3
    (tmp_path / "fast.toml").write_text("yaw = 3.0\n")
    with pytest.raises(UserError, match=r"^fast\.toml: object contains unknown field `yaw`.*known keys: pitch, roll$"):
        load_solo(f"{name}@fast.toml")
    with pytest.raises(UserError, match=r"slow\.toml: no such settings of a law"):
        load_solo(f"{name}@slow.toml")
    plain = module(law(STEER + "x[:3]"))
    with pytest.raises(UserError, match=r"Mine takes no settings; leave @fast\.toml out"):
        load_solo(f"{plain}:Mine@fast.toml")


def test_a_law_in_a_package_is_found_and_all_of_it_counts(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "own_package/laws").mkdir(parents=True)
    (tmp_path / "own_package/laws/mine.py").write_text(law(STEER + "np.zeros(3)"))
    before = own_digest("own_package.laws.mine:Mine")
    assert load_solo("own_package.laws.mine:Mine").name == "own_package.laws.mine:Mine"
    (tmp_path / "own_package/gains.npz").write_bytes(b"gains")
    assert own_digest("own_package.laws.mine:Mine") != before
    assert own_digest("pid") == own_digest(None) == ""


def test_a_law_of_ones_own_is_a_member_of_the_cast_and_its_linear_form_is_itself(module, plant_link, tmp_path):
    name = f"{module(documented())}:MyLaw"
    cast = load_population(ROOT / "populations/citation")
    for switch, first in (("none", name), ("soft", "pid")):
        configuration = resolve("ensemble", overrides=(f'laws=["pid","{name}"]', f"first={first}"), switch=switch)
        log = tmp_path / f"{switch}.ulg"
        link = plant_link(500)
        with Session(link, cast, RecordedReference(ROWS), configuration, log) as session:
            (flown,) = session.fly()
        assert flown.outcome == "over"
        assert not flown.summary.health.get("defect")
        assert np.degrees(link.error(ROWS)).max() < 8.0
    told = ULog(str(log)).msg_info_dict
    assert told["members"].endswith(f'"pid","{name}"]')
    assert f'{{"{name}":"{own_digest(name)}"}}' == told["laws_sha256"]

    mine, x, reference = make_law(name, load_settings(), member=True), np.array(link.x[300]), ROWS[300]
    answer = mine.steer(x, reference).copy()
    maps, memory = mine.linear()
    y = np.concatenate([[1.0], x[:10], np.zeros(13), reference, np.zeros(3)])
    np.testing.assert_allclose((maps @ np.concatenate([memory, y]))[:3], answer, atol=1e-12)


def test_a_law_that_divides_by_the_speed_is_rehearsed(module, plant_link, tmp_path):
    own = load_solo(f"{module(law(STEER + 'np.array([0.1 / float(x[3]), 0.0, 0.0])'))}:Mine")
    configuration = resolve("understudy", overrides=("prior=none", "effectiveness=none"), switch="none")
    with Session(plant_link(10), own, RecordedReference(ROWS), configuration, tmp_path / "f.ulg") as session:
        assert session.fly()[0].summary.health == {}


def test_a_law_without_a_linear_form_is_no_member_of_a_cast(module, plant_link, tmp_path):
    name = f"{module(law(STEER + 'np.zeros(3)'))}:Mine"
    configuration = resolve("ensemble", overrides=(f'laws=["{name}"]', f"first={name}"))
    cast = load_population(ROOT / "populations/citation")
    with pytest.raises(UserError, match=rf"law {name}: linear\(\) is not implemented, so it cannot be a member"):
        Session(plant_link(10), cast, RecordedReference(ROWS), configuration, tmp_path / "f.ulg")


def test_the_command_takes_a_law_of_ones_own_and_says_what_is_none(module):
    name = f"{module(law(STEER + 'np.zeros(3)'))}:Mine"
    configuration = _configure(None, name, None, None, (), None, False)
    assert _describe(_load(None, name, configuration), configuration) == f"the law {name} flies alone"
    with pytest.raises(UserError, match=r"--law: expected one of pid, .*, or MODULE:CLASS of your own, got 'lqr'"):
        _configure(None, "lqr", None, None, (), None, False)
