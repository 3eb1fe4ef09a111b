from __future__ import annotations

import json
from typing import Any

from pipeline.formats.capture import Capture, image_uses


def test_every_place_that_names_a_file_is_found(document: dict[str, Any]) -> None:
    uses = list(image_uses(Capture.model_validate_json(json.dumps(document))))
    named = [u.key for u in uses]
    assert len(named) == len(set(named)) == json.dumps(document).count('"file"')
    assert uses[0].key == "sequences[0].frames[0].file"
    assert (uses[0].file, uses[0].camera, uses[0].purpose) == ("board/0.png", "C0", "calibrate")
    assert uses[0].sequence == 0
    last = uses[-1]
    assert (last.key, last.file, last.purpose) == ("colour_target.file", "target.png", "photos")
    assert last.sequence is None


def test_a_document_survives_a_round_trip(document: dict[str, Any]) -> None:
    capture = Capture.model_validate_json(json.dumps(document))
    again = Capture.model_validate_json(capture.model_dump_json(exclude_none=True))
    assert again == capture
    assert again.model_extra == {"operator": {"kept": True}}


def test_what_is_left_out_has_the_page_s_defaults(document: dict[str, Any]) -> None:
    frames = document["sequences"][1]["frames"]
    frames[2]["pattern"] = {"type": "gray", "axis": "x", "bit": 0, "bits": 4}
    capture = Capture.model_validate_json(json.dumps(document))
    gray, phase = (f.pattern for f in capture.sequences[1].frames[2:4])
    assert (gray.cell_px, gray.inverted) == (1, False)
    assert (phase.phase_offset, phase.sign) == (0.0, 1)
    assert capture.boards["main"].scale_known
    assert not capture.boards["charuco"].scale_known
