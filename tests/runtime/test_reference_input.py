import numpy as np
import pytest

from runtime.reference import LiveReference, load_reference
from task.errors import UserError
from task.state import STATE


def test_a_file_is_put_on_the_samples_and_its_future_is_known(tmp_path):
    file = tmp_path / "reference.csv"
    file.write_text("# made by hand\nt,theta,phi,beta\n0,0.1,0,0\n1,0.2,0.1,0\n")
    reference = load_reference(file)
    assert reference.duration == pytest.approx(1.0)
    np.testing.assert_allclose(reference.at(0.5), [0.15, 0.05, 0.0])
    np.testing.assert_allclose(reference.at(7.0), [0.2, 0.1, 0.0])
    preview = reference.preview(0.98, 5)
    assert preview.dtype == np.float32
    assert preview.shape == (5, 3)
    np.testing.assert_allclose(preview[:, 0], [0.198, 0.199, 0.2, 0.2, 0.2], atol=1e-6)
    np.testing.assert_allclose(reference.preview(100.0, 2)[:, 0], 0.2, atol=1e-6)


def test_npy_and_csv_are_the_same(tmp_path):
    table = np.column_stack([np.arange(50) * 0.01, np.random.default_rng(0).uniform(-0.3, 0.3, (50, 3))])
    np.save(tmp_path / "r.npy", table)
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", fmt="%.17g")
    np.testing.assert_array_equal(
        load_reference(tmp_path / "r.npy").preview(0.0, 50), load_reference(tmp_path / "r.csv").preview(0.0, 50)
    )


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "expected shape"),
        ("t,phi,theta,beta\n0,0,0,0\n", "expected columns t,theta,phi,beta"),
        ("0,0,0\n", "row 1: expected 4 numbers, got 3"),
        ("0,0,x,0\n", "row 1 is not 4 numbers"),
        ("0,0,nan,0\n", "row 1 is not finite"),
        ("0,0,0,0\n0,0,0,0\n", "time must rise; row 2"),
        ("1,0,0,0\n", "first row at t = 0"),
        ("0,5,0,0\n", "are these degrees"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, text, line):
    file = tmp_path / "reference.csv"
    file.write_text(text)
    with pytest.raises(UserError, match=line) as error:
        load_reference(file)
    assert str(file) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(UserError, match="no such reference"):
        load_reference(tmp_path / "nowhere.csv")


def test_a_live_reference_holds_the_pitch_it_finds_until_it_is_told():
    live = LiveReference()
    x = np.zeros(12)
    x[STATE.theta], x[STATE.phi] = 0.05, 0.2
    live.start(x)
    np.testing.assert_allclose(live.at(0.0), [0.05, 0.0, 0.0])
    live.set(0.1, -0.2)
    live.set(np.nan, 0.0)
    np.testing.assert_allclose(live.preview(3.0, 4), [[0.1, -0.2, 0.0]] * 4, atol=1e-7)
    live.start(x)
    np.testing.assert_allclose(live.at(0.0), [0.1, -0.2, 0.0])
