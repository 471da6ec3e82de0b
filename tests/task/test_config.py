from pathlib import Path

import pytest

from task.config import Settings, load_json, load_toml
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
