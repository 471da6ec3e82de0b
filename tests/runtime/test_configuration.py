import inspect

import msgspec
import pytest

from runtime.config import Adaptation, Configuration, Operation
from runtime.presets import PRESETS, resolve
from task.config import convert, to_json
from task.errors import UserError


def test_presets_files_and_overrides_stack_in_that_order(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('preset = "thesis"\n[adaptation]\nkappa = 0.99\nmargin = 0.2\n[operation]\npatience = 3\n')
    configuration = resolve(None, file, ("margin=0.3", "core=1"), "hard")
    assert configuration.preset == "thesis"
    assert configuration.adaptation == msgspec.structs.replace(PRESETS["thesis"], kappa=0.99, margin=0.3, switch="hard")
    assert configuration.operation == Operation(patience=3.0, core=1)
    assert resolve("understudy", file).preset == "understudy"


def test_what_is_saved_is_what_was_resolved():
    configuration = resolve("thesis", None, ("rho=0.1",))
    assert convert(msgspec.json.decode(to_json(configuration)), type(configuration), "saved") == configuration


@pytest.mark.parametrize("preset", PRESETS)
def test_a_flight_is_repeated_from_its_record(tmp_path, preset):
    configuration = resolve(preset, None, ("rho=0.1", "patience=3", "rate_noise=0.00063245553203367"), "hard", True)
    record = tmp_path / "flight.config.json"
    record.write_bytes(to_json(configuration))
    again = resolve(None, record)
    assert again == configuration
    assert to_json(again) == record.read_bytes()


def test_a_record_that_is_none_is_one_line(tmp_path):
    record = tmp_path / "flight.config.json"
    for text, line in (
        ("[1]", "expected `object`"),
        ("{", "not valid JSON"),
        ('{"adaptation": 1}', "expected `object`"),
    ):
        record.write_text(text)
        with pytest.raises(UserError, match=f"flight.config.json: {line}"):
            resolve(None, record)


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (("kapa=1",), "--set kapa: unknown key; known keys: switch"),
        (("kappa",), "expected key=value"),
        (("kappa=2",), "kappa"),
        (("kappa=fast",), "kappa"),
        (("excitation=5",), r"expected `float` <= 0\.17\d+ \[rad\], got 5 - at `\$\.adaptation\.excitation`"),
        (("rate_limits=[-1]",), r"expected `float` > 0\.0 \[rad/s\], got -1 - at `\$\.adaptation\.rate_limits\[0\]`"),
        (("switch=sometimes",), "switch"),
        (("model=full",), "prior = 'population'"),
        (("prior=scheduled",), "prior = 'scheduled' needs identify = false"),
        (("prior=none", "identify=false"), "prior = 'none' with identify = false imagines nothing"),
        (("horizon=-1",), "horizon"),
        (("horizon=1e9",), "horizon"),
        (("recall=1e9",), "recall"),
        (("t_play=inf",), "expected a finite number, got inf.*t_play"),
        (("open_time=inf",), "expected a (finite )?number.*open_time"),
        (("alarm_hold=inf",), "expected a (finite )?number.*alarm_hold"),
        (("kappa=nan",), "kappa"),
        (("margin=inf",), "expected a (finite )?number.*margin"),
        (("delays=[0.1, inf]",), "delays"),
        (("q_bias=[1e300, 0.1, 0.1]",), "expected a (finite )?number.*q_bias"),
        (("q_rate=1e300",), "expected a (finite )?number.*q_rate"),
        (("patience=inf",), "expected a (finite )?number.*patience"),
        (("flush_ticks=2147483648",), "flush_ticks"),
        (("play_delay_ticks=99999999999999999999",), "play_delay_ticks"),
        (("core=1000000000000",), "core"),
        (("dt=1e-9",), "dt"),
        (("dt=1",), "dt"),
    ],
)
def test_a_bad_override_is_one_line(overrides, line):
    with pytest.raises(UserError, match=line) as error:
        resolve("understudy", None, overrides)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[adaptation]\nkapa = 1\n", "kapa"),
        ("[adapt]\nkappa = 1\n", "adapt"),
        ("adaptation = 3\n", "adaptation"),
        ('preset = "best"\n', r"mine\.toml: preset 'best': unknown"),
        ("preset = [1]\n", r"mine\.toml: preset \[1\]: unknown; choose one of understudy"),
        ("preset = {a = 1}\n", "preset {'a': 1}: unknown"),
        ("[adaptation]\nt_play = inf\n", r"mine\.toml: expected a finite number.*t_play"),
        ("[operation]\nflush_ticks = 4000000000\n", r"mine\.toml: .*flush_ticks"),
        ("kappa 1\n", "not valid TOML"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, text, line):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(UserError, match=line):
        resolve(None, file)


def test_what_an_option_makes_whole_need_not_be_valid_in_the_file_alone(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('[adaptation]\nprior = "scheduled"\n')
    assert resolve("understudy", file, ("identify=false",)).adaptation.prior == "scheduled"
    file.write_text('[adaptation]\nprior = "none"\nidentify = false\nmargin = 0.2\n')
    assert resolve("understudy", file, (), "none").adaptation.margin == 0.2
    assert resolve("understudy", file, ("identify=true",)).adaptation.prior == "none"


@pytest.mark.parametrize(
    ("text", "overrides", "line"),
    [
        ('prior = "scheduled"', (), r"mine\.toml: prior = 'scheduled' needs"),
        ('prior = "scheduled"', ("margin=0.2",), r"mine\.toml: prior = 'scheduled' needs"),
        ('prior = "scheduled"', ("kappa=2",), r"--set: expected `float` <= 1\.0, got 2.*kappa"),
        ("kappa = 2", ("kappa=3",), r"--set: expected `float` <= 1\.0, got 3.*kappa"),
        ("kappa = 2", ("margin=0.2",), r"mine\.toml: expected `float` <= 1\.0, got 2.*kappa"),
        ("identify = false", ("prior=none",), r"--set: prior = 'none' with identify = false"),
        ("kapa = 2", ("margin=0.2",), r"mine\.toml: .*unknown field `kapa`"),
    ],
)
def test_a_fault_is_that_of_whom_it_is(tmp_path, text, overrides, line):
    file = tmp_path / "mine.toml"
    file.write_text(f"[adaptation]\n{text}\n")
    with pytest.raises(UserError, match=line):
        resolve("understudy", file, overrides)
    assert resolve("understudy", None) == resolve()  # nothing is left behind in the presets


@pytest.mark.parametrize("kind", [Adaptation, Operation, Configuration])
def test_every_number_is_explained(kind):
    source = inspect.getsource(kind)
    for field in msgspec.structs.fields(kind):
        after = source.split(f"    {field.name}: ", 1)[1].split("\n", 1)[1]
        assert after.startswith('    """'), f"{kind.__name__}.{field.name} has no docstring"
