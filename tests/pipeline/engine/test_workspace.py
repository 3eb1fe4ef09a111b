"""Making, finding and refusing workspaces."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from pipeline.engine.workspace import create_workspace, open_workspace
from pipeline.errors import ImpastoError


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    folder = tmp_path / "captures" / "eye"
    folder.mkdir(parents=True)
    (folder / "capture.json").write_text('{"name": "eye"}')
    return folder


def test_records_the_bundle_twice(bundle: Path, tmp_path: Path) -> None:
    create_workspace(tmp_path / "out", bundle, ("scan",))
    document = json.loads((tmp_path / "out/workspace.json").read_text())
    assert document == {
        "format": "impasto-workspace",
        "version": 1,
        "bundle": {"path": str(bundle), "relative": "../captures/eye"},
    }


def test_is_found_again_after_moves(bundle: Path, tmp_path: Path) -> None:
    create_workspace(tmp_path / "out", bundle, ("scan",))
    shutil.move(tmp_path / "out", tmp_path / "deep" / "out")
    assert open_workspace(tmp_path / "deep/out").bundle == bundle
    shutil.move(tmp_path / "deep/out", tmp_path / "out")
    both = tmp_path / "elsewhere"
    both.mkdir()
    shutil.move(tmp_path / "out", both / "out")
    shutil.move(tmp_path / "captures", both / "captures")
    assert open_workspace(both / "out").bundle == both / "captures/eye"


def test_moved_bundle_is_accepted_and_recorded(bundle: Path, tmp_path: Path) -> None:
    create_workspace(tmp_path / "out", bundle, ("scan",))
    moved = tmp_path / "moved"
    shutil.move(bundle, moved)
    (tmp_path / "out/scan").mkdir()
    assert create_workspace(tmp_path / "out", moved, ("scan",)).bundle == moved
    assert open_workspace(tmp_path / "out").bundle == moved


def test_refuses_another_bundle(bundle: Path, tmp_path: Path) -> None:
    create_workspace(tmp_path / "out", bundle, ("scan",))
    other = tmp_path / "other"
    other.mkdir()
    (other / "capture.json").write_text('{"name": "other"}')
    with pytest.raises(ImpastoError, match=r"workspace of another bundle, .*captures/eye"):
        create_workspace(tmp_path / "out", other, ("scan",))


@pytest.mark.parametrize("inside", ["", "out", "a/b"])
def test_refuses_to_write_into_the_bundle(bundle: Path, inside: str) -> None:
    with pytest.raises(ImpastoError, match="lies inside the capture bundle"):
        create_workspace(bundle / inside, bundle, ("scan",))
    assert [path.name for path in bundle.iterdir()] == ["capture.json"]


def test_refuses_to_write_into_the_bundle_through_a_link(bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(bundle)
    with pytest.raises(ImpastoError, match="lies inside the capture bundle"):
        create_workspace(tmp_path / "link/out", bundle, ("scan",))


def test_never_replaces_what_it_did_not_make(bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "out/scan").mkdir(parents=True)
    (tmp_path / "out/scan/thesis.txt").write_text("years of work")
    with pytest.raises(ImpastoError, match="scan exists already and was not made by a stage"):
        create_workspace(tmp_path / "out", bundle, ("calibrate", "scan"))
    assert not (tmp_path / "out/.engine").exists()


def test_the_folder_may_hold_other_things(bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "captures/notes").mkdir()
    create_workspace(tmp_path / "captures", bundle, ("scan",))
    assert (tmp_path / "captures/workspace.json").exists()


def test_refuses_what_is_no_bundle(tmp_path: Path) -> None:
    with pytest.raises(ImpastoError, match="not a capture bundle"):
        create_workspace(tmp_path / "out", tmp_path, ("scan",))
    with pytest.raises(ImpastoError, match="no such folder"):
        create_workspace(tmp_path / "out", tmp_path / "nowhere", ("scan",))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"format": "impasto-workspace", "version": 2, "bundle": {}}']
)
def test_damaged_record(tmp_path: Path, text: str) -> None:
    (tmp_path / "workspace.json").write_text(text)
    with pytest.raises(ImpastoError, match=r"workspace\.json: it cannot be read"):
        open_workspace(tmp_path)


def test_opening_changes_nothing(bundle: Path, tmp_path: Path) -> None:
    with pytest.raises(ImpastoError, match="not a workspace"):
        open_workspace(bundle)
    with pytest.raises(ImpastoError, match="not a workspace"):
        open_workspace(bundle / "capture.json")
    assert [path.name for path in bundle.iterdir()] == ["capture.json"]
