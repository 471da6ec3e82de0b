from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest

from task.config import Settings, convert, load_json, load_toml
from task.errors import UserError


class Inner(Settings):
    angle: float = 0.0


class Cat(Settings, tag_field="kind", tag="cat"):
    lives: int = 9


class Dog(Settings, tag_field="kind", tag="dog"):
    name: str = "Rex"


class Outer(Settings):
    name: str
    inner: Inner = Inner()
    many: tuple[Inner, ...] = ()
    pets: tuple[Cat | Dog, ...] = ()
    named: dict[str, Inner] = {}


def refusal(tmp_path: Path, text: str) -> str:
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        load_toml(path, Outer)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def test_good_file(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text('name = "a"\n[[many]]\nangle = 1\n')
    assert load_toml(path, Outer) == Outer(name="a", many=(Inner(angle=1.0),))


def test_unknown_key_names_where_and_what_is_known(tmp_path: Path) -> None:
    message = refusal(tmp_path, 'name = "a"\n[[many]]\nangel = 1\n')
    assert "angel" in message
    assert "many" in message
    assert "known keys: angle" in message
    assert "known keys: name, inner, many, pets, named" in refusal(tmp_path, 'name = "a"\nspeed = 3\n')
    pets = 'name = "a"\n[[pets]]\nkind = "cat"\n[[pets]]\nkind = "dog"\nlives = 1\n'
    assert refusal(tmp_path, pets).endswith("known keys: name")
    assert "unknown field `lives`" in refusal(tmp_path, 'name = "a"\n[named.x]\nlives = 1\n')


def test_wrong_type_missing_key_and_bad_syntax(tmp_path: Path) -> None:
    assert "expected `float`, got `str`" in refusal(tmp_path, 'name = "a"\n[inner]\nangle = "up"\n')
    assert "name" in refusal(tmp_path, "")
    assert "not valid TOML" in refusal(tmp_path, "name = \n")


def test_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such configuration"):
        load_toml(tmp_path / "none.toml", Outer)
    bad = tmp_path / "x.json"
    bad.write_text("{")
    with pytest.raises(UserError, match="not valid JSON"):
        load_json(bad, Outer)


class Numbers(Settings):
    size: float = 0.0
    above: Annotated[float, msgspec.Meta(gt=0.0)] = 1.0
    count: Annotated[int, msgspec.Meta(ge=0)] = 0
    by_name: dict[str, Annotated[float, msgspec.Meta(ge=0.0)]] = {}
    many: tuple[tuple[float, float], ...] = ()
    colour: Literal["red", "blue"] | None = None
    colours: tuple[Literal["red", "blue"], ...] = ()
    pets: tuple[Cat | Dog, ...] = ()
    kept: dict[str, Any] = {}


class Timed(Settings):
    start: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    """When it begins [s]; from [0] on."""


class Units(Timed):
    """Fields with units, and some [kg] that is none of theirs."""

    angle: Annotated[float, msgspec.Meta(le=0.5)] = 0.0
    """Between [0, 0.5], how far it goes [rad; a turn
    has 6.28]; not [m]."""
    share: Annotated[float, msgspec.Meta(le=1.0)] = 0.0
    """Of the range [-], which is [rad]."""
    growth: Annotated[float, msgspec.Meta(le=1.0)] = 0.0
    """How it grows [1/s2]."""
    silent: Annotated[float, msgspec.Meta(le=1.0)] = 0.0
    many: tuple[Annotated[float, msgspec.Meta(le=1.0)], ...] = ()
    """Each [m/s]."""
    inner: tuple[Timed, ...] = ()
    """Some [Hz]."""


@pytest.mark.parametrize(
    ("data", "line"),
    [
        ({"angle": 5}, "s.toml: expected `float` <= 0.5 [rad], got 5 - at `$.angle`"),
        ({"start": -1}, "s.toml: expected `float` >= 0.0 [s], got -1 - at `$.start`"),
        ({"share": 2}, "s.toml: expected `float` <= 1.0, got 2 - at `$.share`"),
        ({"growth": 2}, "s.toml: expected `float` <= 1.0 [1/s2], got 2 - at `$.growth`"),
        ({"silent": 2}, "s.toml: expected `float` <= 1.0, got 2 - at `$.silent`"),
        ({"many": [0, 2]}, "s.toml: expected `float` <= 1.0 [m/s], got 2 - at `$.many[1]`"),
        ({"inner": [{"start": -1}]}, "s.toml: expected `float` >= 0.0 [s], got -1 - at `$.inner[0].start`"),
    ],
)
def test_a_number_out_of_range_is_told_its_unit(data: Any, line: str) -> None:
    with pytest.raises(UserError) as caught:
        convert(data, Units, "s.toml")
    assert str(caught.value) == line


def test_settings_without_source_are_refused_without_a_unit() -> None:
    names: dict[str, Any] = {"Timed": Timed, "Annotated": Annotated, "msgspec": msgspec}
    exec("class Made(Timed):\n    a: Annotated[float, msgspec.Meta(le=1.0)] = 0.0\n    '''[m]'''\n", names)
    with pytest.raises(UserError, match=r"expected `float` <= 1\.0, got 2 - at `\$\.a`"):
        convert({"a": 2}, names["Made"], "s.toml")


def answer(data: Any) -> str:
    with pytest.raises(UserError) as caught:
        convert(data, Numbers, "s.toml")
    return str(caught.value)


def test_a_wrong_choice_names_the_choices() -> None:
    choices = "s.toml: invalid enum value 'green' - at `$.colour`; choose from red, blue"
    assert answer({"colour": "green"}) == choices
    assert answer({"colours": ["red", "green"]}).endswith("at `$.colours[1]`; choose from red, blue")
    assert answer({"pets": [{"kind": "cow"}]}).endswith("'cow' - at `$.pets[0].kind`; choose from cat, dog")


def test_a_number_out_of_range_says_what_was_got() -> None:
    assert answer({"above": float("nan")}) == "s.toml: expected `float` > 0.0, got nan - at `$.above`"
    assert answer({"count": -1}) == "s.toml: expected `int` >= 0, got -1 - at `$.count`"
    assert (
        answer({"by_name": {"p": 1.0, "q": -2.0}}) == "s.toml: expected `float` >= 0.0, got -2.0 - at `$.by_name[...]`"
    )
    assert answer({"count": 0.5}) == "s.toml: expected `int`, got `float` - at `$.count`"


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), float("-inf")])
def test_no_number_of_any_settings_may_be_infinite(wrong: float) -> None:
    assert answer({"size": wrong}) == f"s.toml: expected a finite number, got {wrong} - at `$.size`"
    assert answer({"many": [[0.0, 1.0], [0.0, wrong]]}).endswith("at `$.many[1][1]`")
    assert answer({"kept": {"a": [wrong]}}).endswith("at `$.kept.a[0]`")


def test_numbers_are_no_larger_than_what_calculates_with_them_holds() -> None:
    assert answer({"size": -1e39}) == "s.toml: expected a number up to 1e+30, got -1e+39 - at `$.size`"
    assert "got 1000000000" in answer({"size": 10**400})
    assert answer({"count": 2**31}).endswith("got 2147483648 - at `$.count`")
    assert convert({"size": 10**12, "count": 2**31 - 1, "kept": {"n": 2**40}}, Numbers, "s").size == 1e12


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path):
    for name, load, text in (("a.toml", load_toml, 'name = "ü"\n'), ("a.json", load_json, '{"name": "ü"}')):
        (tmp_path / name).write_text(text, encoding="utf-8-sig")
        assert load(tmp_path / name, Outer) == Outer(name="ü")
