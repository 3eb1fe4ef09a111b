from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.atomic import atomic_path, write_text_atomically


def test_the_file_appears_whole_and_replaces_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    path.write_text("old")
    with atomic_path(path) as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".exr"
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_failure_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, error: type[BaseException]
) -> None:
    path = tmp_path / "a.json"
    path.write_text("old")

    def fail() -> None:
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_block_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    expected = pytest.raises(ImpastoError, match=r"a\.json: the file cannot be written")
    with expected, atomic_path(tmp_path / "a.json"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_an_error_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ImpastoError, match="cannot be written") as info:
        write_text_atomically(tmp_path / "absent" / "a.json", "{}")
    assert info.value.exit_status == 1
    assert "\n" not in str(info.value)


def test_text_is_written_as_utf_8_without_translation(tmp_path: Path) -> None:
    write_text_atomically(tmp_path / "a.txt", "µ\r\n\n")
    assert (tmp_path / "a.txt").read_bytes() == b"\xc2\xb5\r\n\n"
