"""What a message tells the user to do is done here, and works."""

import re

import msgspec
import pytest

from runtime.population import load_population
from runtime.presets import resolve
from runtime.reference import LiveReference
from runtime.session import Session
from task.errors import UserError


def prepare(cast, tmp_path, preset, *overrides):
    """Make everything that is made before a flight; nobody speaks on the link."""
    with Session(object(), cast, LiveReference(), resolve(preset, None, overrides), tmp_path / "f.ulg"):
        pass


def remedies(cast, tmp_path, preset, *overrides):
    """Return the values of --set and --preset in the message that this configuration is refused with."""
    with pytest.raises(UserError) as refused:
        prepare(cast, tmp_path, preset, *overrides)
    found = re.findall(r"--(?:set|preset) ('[^']*'|[^ ;,]+)", str(refused.value))
    assert found
    return [value.strip("'") for value in found]


@pytest.fixture
def cast(mirrored_folder):
    return load_population(mirrored_folder)


@pytest.mark.parametrize("preset", ["structured", "ensemble"])
def test_a_population_without_a_rate_model_flies_as_the_message_says(cast, tmp_path, preset):
    cast = cast._replace(rates=None)
    (instead,) = remedies(cast, tmp_path, preset)
    prepare(cast, tmp_path, instead)
    (too,) = remedies(cast, tmp_path, preset, "effectiveness=none")
    prepare(cast, tmp_path, preset, "effectiveness=none", too)


def test_a_law_of_a_members_name_is_left_out_as_the_message_says(cast, tmp_path):
    good, *others = cast.manifest.members
    members = (*others, msgspec.structs.replace(good, name="indi-rls-protected"))
    manifest = msgspec.structs.replace(cast.manifest, members=members, champion="indi-rls-protected")
    cast = cast._replace(manifest=manifest)
    prepare(cast, tmp_path, "ensemble", *remedies(cast, tmp_path, "ensemble"))
    kept = remedies(cast, tmp_path, "ensemble", 'laws=["pid","indi-rls-protected"]')
    assert kept == ['laws=["pid"]']


def test_a_first_member_that_is_not_there_is_named_anew_as_the_message_says(cast, tmp_path):
    name, champion = remedies(cast, tmp_path, "ensemble", "laws=[]")
    assert name == "first=NAME"
    prepare(cast, tmp_path, "ensemble", "laws=[]", champion)
    prepare(cast, tmp_path, "ensemble", "laws=[]", f"first={cast.members[-1]}")
