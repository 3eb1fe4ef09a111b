from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, Field

from pipeline.errors import ImpastoError
from pipeline.formats import strict_json
from pipeline.formats.strict_json import parse_model, parse_object, read_text


class Leaf(BaseModel):
    type: Literal["leaf"]
    size: float = Field(gt=0)


class Twig(BaseModel):
    type: Literal["twig"]
    leaves: tuple[Leaf, ...]


class Tree(BaseModel):
    name: str
    parts: tuple[Leaf | Twig, ...] = Field(discriminator=None)
    named: dict[str, Leaf] = {}


REFUSED = {
    '{"a": 1, "a": 2}': "d.json: a: the key is given twice",
    '{"a": [{"b": {"c": 1, "c": 1}}]}': r"d.json: a\[0\].b.c: the key is given twice",
    '{"a": NaN}': "d.json: a: nan is not a number",
    '{"a": [1, {"b": Infinity}]}': r"d.json: a\[1\].b: inf is not",
    '{"a": -Infinity}': "d.json: a: -inf is not",
    '{"a": 1e999}': "d.json: a: inf is not",
    "": "d.json: is not JSON: .* line 1, column 1",
    '{"a": 1': "d.json: is not JSON: .* line 1, column 8",
    "{'a': 1}": "d.json: is not JSON",
    '{"a": 1}}': "d.json: is not JSON: Extra data",
    "[1]": r"d.json: holds \[1\]; expected a JSON object",
    "3": "d.json: holds 3; expected a JSON object",
    "null": "d.json: holds null; expected a JSON object",
    '{"a":' * 65 + "1" + "}" * 65: "d.json: a.*: is nested more than 64",
    "[" * 100_000: "d.json: is nested more than 64",
    '{"a":' * 5000 + "1" + "}" * 5000: "d.json: is nested more than 64",
    '{"a": ' + "9" * 10_000 + "}": "d.json: holds a number of too many digits",
}


@pytest.mark.parametrize(("text", "message"), REFUSED.items(), ids=range(len(REFUSED)))
def test_what_is_not_strict_json_is_refused(text: str, message: str) -> None:
    with pytest.raises(ImpastoError, match=message) as info:
        parse_object(text, where="d.json")
    assert "\n" not in str(info.value)
    assert len(str(info.value)) < 300


def test_the_deepest_allowed_document_is_read() -> None:
    assert parse_object('{"a":' * 64 + "1" + "}" * 64, where="d.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"parts": []}', "d.json: name: the key is missing"),
        ('{"name": 3, "parts": []}', "d.json: name: 3 is not allowed; expected a valid string"),
        (
            '{"name": "a", "parts": [], "named": {"b": {"type": "leaf", "size": 0}}}',
            "d.json: named.b.size: 0 is not allowed; expected greater than 0",
        ),
        (
            '{"name": "a", "parts": [], "named": {"b": {"type": "leaf", "size": "1"}}}',
            'd.json: named.b.size: "1" is not allowed; expected a valid number',
        ),
        (
            '{"name": 1, "parts": 2, "named": 3}',
            "d.json: name: 1 is not allowed; expected a valid string; 2 more entries are wrong too",
        ),
    ],
)
def test_a_model_s_errors_name_the_key(text: str, message: str) -> None:
    with pytest.raises(ImpastoError) as info:
        parse_model(Tree, text, where="d.json")
    assert str(info.value) == message


def test_half_a_character_is_refused() -> None:
    with pytest.raises(ImpastoError, match=r"^d\.json: is not JSON: .*hex escape"):
        parse_model(Tree, '{"name": "\\ud800", "parts": []}', where="d.json")


def test_long_values_are_shortened() -> None:
    with pytest.raises(ImpastoError) as info:
        parse_model(Tree, '{"name": [' + "1, " * 999 + '1], "parts": []}', where="d.json")
    assert len(str(info.value)) < 150


def test_a_byte_order_mark_is_dropped_and_other_encodings_refused(tmp_path: Path) -> None:
    path = tmp_path / "d.json"
    path.write_bytes(b'\xef\xbb\xbf{"a": "\xc2\xb5"}')
    assert parse_object(read_text(path, where="d.json"), where="d.json") == {"a": "µ"}
    path.write_bytes('{"a": "µ"}'.encode("latin-1"))
    with pytest.raises(ImpastoError, match=r"d.json: is not UTF-8 at byte 7"):
        read_text(path, where="d.json")


def test_a_file_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strict_json, "MAX_BYTES", 10)
    path = tmp_path / "d.json"
    path.write_text('{"a": 123}')
    assert read_text(path, where="d.json")
    path.write_text('{"a": 1234}')
    with pytest.raises(ImpastoError, match="larger than"):
        read_text(path, where="d.json")


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@given(st.text() | json_values.map(lambda v: __import__("json").dumps(v)))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        document = parse_object(text, where="d.json")
    except ImpastoError:
        return
    assert isinstance(document, dict)
