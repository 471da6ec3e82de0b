"""Files that are written whole, or not at all."""

import pytest

from task.errors import UserError
from task.files import atomic


@pytest.mark.parametrize(
    ("error", "raised"),
    [(OSError(28, "No space left on device"), UserError), (KeyboardInterrupt(), KeyboardInterrupt)],
)
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(error, raised, tmp_path):
    path = tmp_path / "state"
    path.write_bytes(b"old")

    def write():
        with atomic(path) as file:
            file.write(b"new")
            raise error

    with pytest.raises(raised):
        write()
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("state", b"old")]


def test_a_disk_that_takes_nothing_is_one_line(tmp_path):
    with (
        pytest.raises(UserError, match=r"nowhere/state: cannot be written: No such file"),
        atomic(tmp_path / "nowhere" / "state"),
    ):
        pass


def test_what_is_written_takes_the_place_of_the_old(tmp_path):
    path = tmp_path / "state"
    path.write_bytes(b"old")
    with atomic(path) as file:
        file.write(b"new")
        assert path.read_bytes() == b"old"
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("state", b"new")]
