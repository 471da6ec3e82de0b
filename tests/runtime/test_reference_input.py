import io

import numpy as np
import pytest

from runtime.reference import LiveReference, Trend, load_reference
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
        ("-2,0,0,0\n-1,0,0,0\n", "last row between t = 0 s and 86400 s, a day, got -1 s"),
        ("0,0,0,0\n1e300,0,0,0\n", "got 1e.300 s; are these seconds"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, text, line):
    file = tmp_path / "reference.csv"
    file.write_text(text)
    with pytest.raises(UserError, match=line) as error:
        load_reference(file)
    assert str(file) in str(error.value)
    assert "\n" not in str(error.value)


def saved(array, allow_pickle=False):
    file = io.BytesIO()
    np.save(file, array, allow_pickle=allow_pickle)
    return file.getvalue()


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "not a NumPy array of numbers"),
        (b"t,theta", "not a NumPy array of numbers"),
        (saved(np.zeros((3, 4)))[:-8], "not a NumPy array of numbers"),
        (saved(np.array([["0", "0", "0", "0"]])), "expected numbers, got an array of <U1"),
        (saved(np.zeros((1, 4), dtype=complex)), "expected numbers, got an array of complex128"),
        (saved(np.full((1, 4), None), allow_pickle=True), "not a NumPy array of numbers"),
        (saved(np.float64(0.0)), "expected shape"),
    ],
)
def test_a_bad_array_is_one_line(tmp_path, content, line):
    file = tmp_path / "reference.npy"
    file.write_bytes(content)
    with pytest.raises(UserError, match=line) as error:
        load_reference(file)
    assert str(file) in str(error.value)
    assert "\n" not in str(error.value)


def test_an_archive_is_no_array(tmp_path):
    with (tmp_path / "reference.npy").open("wb") as file:
        np.savez(file, rows=np.zeros((1, 4)))
    with pytest.raises(UserError, match="not a NumPy array"):
        load_reference(tmp_path / "reference.npy")


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
    assert live.preview(3.0, 4) is None
    live.start(x)
    np.testing.assert_allclose(live.at(0.0), [0.1, -0.2, 0.0])


def seen(rows, time):
    """Return what Trend makes of rows seen one after the other, 201 samples from the last one on."""
    trend = Trend(time)
    for tick, row in enumerate(rows):
        trend.see(tick, row)
    return trend.ahead(201)


def ramp(theta, phi, samples=100):
    t = np.arange(samples) * 0.01
    return np.column_stack([0.1 + theta * t, phi * t, 0.0 * t])


def test_what_nobody_knows_goes_on_as_it_moves_and_slows_down():
    ahead = seen(ramp(0.05, -0.2), 0.5)
    assert ahead.dtype == np.float32
    last = ramp(0.05, -0.2)[-1]
    np.testing.assert_allclose(ahead[0], last, atol=1e-7)
    np.testing.assert_allclose((ahead[1] - ahead[0]) / 0.01, [0.05, -0.2, 0.0], rtol=0.02, atol=1e-6)
    moved = 0.5 * (1.0 - np.exp(-2.0 / 0.5))  # of the rate, after 2 s
    np.testing.assert_allclose(ahead[200], last + moved * np.array([0.05, -0.2, 0.0]), atol=1e-6)


@pytest.mark.parametrize(
    "rows",
    [
        pytest.param(ramp(0.05, -0.2)[:30], id="not yet seen for three windows"),
        pytest.param(np.repeat([[0.0, 0.0, 0.0], [0.3, 0.3, 0.0]], [90, 10], axis=0), id="a step"),
        pytest.param(np.abs(ramp(0.05, -0.2) - ramp(0.05, -0.2)[85]), id="turned round"),
        pytest.param(np.repeat(ramp(0.05, -0.2)[::25], 25, axis=0), id="set-points four times a second"),
    ],
)
def test_what_does_not_move_steadily_is_held(rows):
    np.testing.assert_allclose(seen(rows, 0.5), np.tile(rows[-1], (201, 1)), atol=1e-7)


def test_a_ramp_that_slows_down_goes_on_with_its_least_slope():
    t = np.arange(100) * 0.01
    rows = np.column_stack([0.1 * t - 0.05 * t**2, 0.0 * t, 0.0 * t])
    slope = (rows[-1, 0] - rows[-11, 0]) / 0.1
    np.testing.assert_allclose(np.gradient(seen(rows, 2.0)[:, 0], 0.01)[0], slope, rtol=0.01)


def test_a_gap_is_no_slope():
    rows, trend = ramp(0.05, -0.2, 200), Trend(0.5)
    for tick in (*range(100), *range(150, 180)):
        trend.see(tick, rows[tick])
    np.testing.assert_allclose(trend.ahead(201), np.tile(rows[179], (201, 1)), atol=1e-7)
    trend.see(180, rows[180])  # three windows after the gap
    np.testing.assert_allclose(np.diff(trend.ahead(2), axis=0)[0] / 0.01, [0.05, -0.2, 0.0], rtol=0.02, atol=1e-5)


def test_without_a_time_the_present_is_held():
    np.testing.assert_array_equal(seen(ramp(0.05, -0.2), 0.0), np.tile(np.float32(ramp(0.05, -0.2)[-1]), (201, 1)))


def test_a_byte_order_mark_is_no_part_of_a_table(tmp_path):
    for header in ("t,theta,phi,beta\n", ""):
        (tmp_path / "a.csv").write_text(f"{header}0,0.1,0,0\n1,0.1,0,0\n", encoding="utf-8-sig")
        assert load_reference(tmp_path / "a.csv").at(0.5)[0] == pytest.approx(0.1)
