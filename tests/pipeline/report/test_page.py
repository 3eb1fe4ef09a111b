"""The whole page, from a workspace that a run left."""

from __future__ import annotations

import re
import shutil
from html.parser import HTMLParser

import pytest

from pipeline.engine.batch import Job, run_job
from pipeline.engine.display import make_display
from pipeline.engine.runner import Selection
from pipeline.engine.workspace import open_workspace
from pipeline.errors import ImpastoError
from pipeline.recipe import RECIPE
from pipeline.report.page import read_contents, write_report
from pipeline.report.truth import errors_against_truth


@pytest.fixture(scope="module")
def processed(small_capture, tmp_path_factory):
    """The small canvas, as far as the boxes."""
    out = tmp_path_factory.mktemp("page")
    with make_display(quiet=True, terminal=False) as display:
        run_job(
            Job(small_capture("canvas") / "bundle", out, RECIPE, Selection(last="classify")),
            display,
        )
    return out


class Links(HTMLParser):
    """Collects what the page refers to, and its sections."""

    def __init__(self):
        super().__init__()
        self.addresses, self.sections, self.scripts = [], [], 0

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.addresses += [found[key] for key in ("src", "href") if key in found]
        self.scripts += tag == "script"
        if tag == "section":
            self.sections.append(found["id"])


def read(page):
    links = Links()
    links.feed(page)
    return links


def test_all_that_is_there_is_shown_without_outside_resources(processed, tmp_path, small_capture):
    from pipeline.formats.height_field import HEIGHT

    truth = errors_against_truth(HEIGHT.load(processed), small_capture("canvas") / "truth")
    out = tmp_path / "page.html"
    write_report(open_workspace(processed), out, truth=truth)
    page = out.read_text(encoding="utf-8")
    links = read(page)
    assert links.sections == [
        "capture", "calibration", "range", "height", "relief", "truth", "stages",
    ]  # fmt: skip
    assert all(address.startswith(("data:", "#")) for address in links.addresses)
    assert not re.search(r"url\(\s*['\"]?(?!data:)", page)
    assert links.scripts == 0
    for anchor in (a[1:] for a in links.addresses if a.startswith("#")):
        assert anchor in links.sections
    assert "calibration from boards" in page  # what was skipped
    assert "10 photographs under the lamp" in page


def test_an_unfinished_workspace_is_shown_as_far_as_it_got(processed, tmp_path):
    half = tmp_path / "half"
    shutil.copytree(processed, half)
    for stage in ("extract", "classify"):
        shutil.rmtree(half / stage)
    write_report(open_workspace(half), half / "r.html")
    sections = read((half / "r.html").read_text()).sections
    assert sections == ["capture", "calibration", "range", "stages"]


def test_a_capture_that_was_archived_is_left_out(processed, tmp_path, monkeypatch):
    import pipeline.report.page as module

    def gone(_folder):
        raise ImpastoError("the file does not exist")

    monkeypatch.setattr(module, "open_bundle", gone)
    contents = read_contents(open_workspace(processed))
    assert contents.bundle is None
    write_report(open_workspace(processed), tmp_path / "r.html")
    assert "capture" not in read((tmp_path / "r.html").read_text()).sections


def test_an_empty_workspace_is_refused(processed, tmp_path):
    shutil.copy(processed / "workspace.json", tmp_path)
    with pytest.raises(ImpastoError, match="no stage has run"):
        write_report(open_workspace(tmp_path), tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()
