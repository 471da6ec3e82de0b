"""The recorder of the true states."""

from __future__ import annotations

import numpy as np
import pytest

from sim_bridge.truth import Truth, prepare, write_whole
from task.errors import UserError


def recorded(ticks: int) -> Truth:
    truth = Truth(10, ["jam", "ice"])
    for k in range(ticks):
        truth.state(k * 10_000, np.arange(12.0) + k, np.full(3, 0.1 * k), np.array([1.0, 0, 0]), [0.5 * (k > 1), 0.0])
        truth.command(np.full(3, 0.01 * k), k * 10_000)
    truth.state(ticks * 10_000, np.arange(12.0) + ticks, np.zeros(3), np.zeros(3), [1.0, 0.0])
    return truth


def test_what_was_recorded_is_read_back_without_pickle(tmp_path):
    recorded(4).save(tmp_path / "t.npz")
    with np.load(tmp_path / "t.npz", allow_pickle=False) as file:
        assert file["time_us"].tolist() == [0, 10_000, 20_000, 30_000, 40_000]
        assert file["time_us"].dtype == np.int64
        assert file["x"].shape == (5, 12)
        assert file["x"][3, 5] == 8.0
        assert file["command"].shape == (4, 3)
        assert file["echo_us"].tolist() == [0, 10_000, 20_000, 30_000]
        assert file["faults"].tolist() == [[0.0, 0.0]] * 2 + [[0.5, 0.0]] * 2 + [[1.0, 0.0]]
        assert file["fault_names"].tolist() == ["jam", "ice"]


def test_a_flight_without_faults_has_an_empty_table_of_them(tmp_path):
    truth = Truth(2, [])
    truth.state(0, np.zeros(12), np.zeros(3), np.zeros(3), [])
    truth.save(tmp_path / "t.npz")
    with np.load(tmp_path / "t.npz", allow_pickle=False) as file:
        assert file["faults"].shape == (1, 0)
        assert file["fault_names"].shape == (0,)


def test_equal_flights_give_equal_files_and_nothing_is_left_beside_them(tmp_path):
    recorded(3).save(tmp_path / "a.npz")
    recorded(3).save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_nothing_is_left_beside_a_file_whose_writing_is_interrupted(tmp_path):
    def interrupted(file):
        file.write(b"half")
        raise KeyboardInterrupt

    (tmp_path / "t").write_text("old")
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "t", interrupted)
    assert [p.name for p in tmp_path.iterdir()] == ["t"]
    assert (tmp_path / "t").read_text() == "old"


def test_names_that_bring_no_fault_copy_nothing():
    truth = recorded(2)
    before = truth._faults
    truth.name_faults(["jam", "ice"])
    assert truth._faults is before
    truth.name_faults(["jam", "ice", "gust"])
    assert truth.arrays()["faults"].shape == (3, 3)
    assert truth.arrays()["fault_names"].tolist() == ["jam", "ice", "gust"]


def test_a_file_that_cannot_be_written_is_one_line_and_the_old_one_stays(tmp_path):
    target = tmp_path / "t.npz"
    target.mkdir()
    with pytest.raises(UserError, match=r"t\.npz: cannot be written") as error:
        recorded(1).save(target)
    assert "\n" not in str(error.value)
    assert [p.name for p in tmp_path.iterdir()] == ["t.npz"]


def test_an_output_is_checked_before_anything_flies(tmp_path):
    prepare(tmp_path / "new" / "folder" / "t.npz")
    assert (tmp_path / "new" / "folder").is_dir()
    with pytest.raises(UserError, match="expected a file"):
        prepare(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot make the folder"):
        prepare(tmp_path / "file" / "t.npz")
