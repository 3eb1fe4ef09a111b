from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.inside import locate, relative_name

BAD_NAMES = {
    "": "empty",
    "  ": "empty",
    "/etc/passwd": "absolute",
    "//server/share/a.png": "absolute",
    "C:/a.png": "absolute",
    "c:a.png": "absolute",
    "C:\\a.png": "absolute",
    "\\\\server\\share\\a.png": "backslash",
    "scan\\..\\..\\a.png": "backslash",
    "..": "leads out",
    "../a.png": "leads out",
    "scan/../../a.png": "leads out",
    "scan/../a.png": "leads out",
    ".": "leads out",
    "a\x00.png": "control",
    "a\n.png": "control",
    "a" * 2000: "too long",
}


@pytest.mark.parametrize(("name", "problem"), BAD_NAMES.items())
def test_names_that_could_lead_out_are_refused(tmp_path: Path, name: str, problem: str) -> None:
    with pytest.raises(ImpastoError, match=problem):
        relative_name(name)
    with pytest.raises(ImpastoError, match=problem):
        locate(tmp_path, name)


@pytest.mark.parametrize("name", ["a.png", "scan/000.png", "./scan/a b.png", "..a/b..png", "µ.png"])
def test_names_inside_are_found(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"x")
    assert locate(tmp_path, name).read_bytes() == b"x"


def test_links_are_refused_wherever_they_lead(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    folder = tmp_path / "bundle"
    for made in (outside, folder / "real"):
        made.mkdir(parents=True)
        (made / "a.png").write_bytes(b"x")
    (folder / "file.png").symlink_to(outside / "a.png")
    (folder / "within.png").symlink_to("real/a.png")
    (folder / "out").symlink_to(outside)
    (folder / "dangling.png").symlink_to("nothing")
    for name in ("file.png", "within.png", "out/a.png", "dangling.png"):
        with pytest.raises(ImpastoError, match=f"through the link '{name.split('/')[0]}'"):
            locate(folder, name)


def test_the_bundle_itself_may_be_reached_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "a.png").write_bytes(b"x")
    (tmp_path / "link").symlink_to("real")
    assert locate(tmp_path / "link", "a.png").is_file()


def test_what_is_no_regular_file_is_refused_without_opening_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo.png")
    (tmp_path / "folder.png").mkdir()
    for name in ("fifo.png", "folder.png"):
        with pytest.raises(ImpastoError, match="not a regular file"):
            locate(tmp_path, name)


@pytest.mark.parametrize("name", ["absent.png", "absent/a.png", "file.png/a.png"])
def test_missing_files_are_said_to_be_missing(tmp_path: Path, name: str) -> None:
    (tmp_path / "file.png").write_bytes(b"x")
    with pytest.raises(ImpastoError, match="is missing"):
        locate(tmp_path, name)


def test_a_part_longer_than_the_file_system_allows_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ImpastoError, match="cannot be reached"):
        locate(tmp_path, "a" * 500 + ".png")
