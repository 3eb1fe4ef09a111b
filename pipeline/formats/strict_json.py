"""JSON documents read strictly: no repeated keys, no NaN, bounded size and depth, typed."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from pipeline.errors import ImpastoError

MAX_BYTES = 64 << 20
MAX_DEPTH = 64
Model = TypeVar("Model", bound=BaseModel)


class _Object(dict[str, Any]):
    """An object of the document that remembers a key given twice."""

    repeated: str | None = None


def read_text(path: Path, *, where: str) -> str:
    """Read a UTF-8 text of bounded size; a byte-order mark is dropped.

    Raises
    ------
    ImpastoError
        If it cannot be read, is too large or is not UTF-8.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ImpastoError(f"cannot be read ({error.strerror or error})", where=where) from error
    if len(data) > MAX_BYTES:
        raise ImpastoError(
            "is larger than 64 MiB", where=where, fix="keep images in files of their own"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ImpastoError(
            f"is not UTF-8 at byte {error.start}", where=where, fix="save it as UTF-8"
        ) from None


def parse_object(text: str, *, where: str) -> dict[str, Any]:
    """Parse a JSON object.

    Raises
    ------
    ImpastoError
        If it is not JSON, not an object, nested deeper than ``MAX_DEPTH``, repeats a key, or
        holds NaN or an infinite number; naming the key.
    """
    try:
        document = json.loads(text, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        raise ImpastoError(
            f"is not JSON: {error.msg} in line {error.lineno}, column {error.colno}", where=where
        ) from None
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError:
        raise ImpastoError("holds a number of too many digits", where=where) from None
    if not isinstance(document, dict):
        raise ImpastoError(
            f"holds {_short(document)}", where=where, expected="a JSON object, { ... }"
        )
    _check_values(document, where, "", 0)
    return document


def parse_model(model: type[Model], text: str, *, where: str) -> Model:
    """Parse a JSON object into a pydantic model, without converting between types.

    Raises
    ------
    ImpastoError
        As :func:`parse_object`, or for the first key that is missing or has a wrong value, as
        ``capture.json: photos[3].exposure_s``.
    """
    document = parse_object(text, where=where)
    try:
        return model.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise explain(error, document, where=where) from None


def explain(error: ValidationError, document: Any, *, where: str) -> ImpastoError:
    """Turn pydantic's findings into one error that names the first bad key of ``document``."""
    finding = error.errors(include_url=False, include_context=False)[0]
    more = error.error_count() - 1
    fix = f"{more} more {'entry is' if more == 1 else 'entries are'} wrong too" if more else None
    key = _key(finding["loc"], document)
    message = str(finding["msg"])
    if finding["type"] == "missing":
        return ImpastoError("the key is missing", where=f"{where}: {key}", fix=fix)
    if finding["type"] == "json_invalid":  # what only the second parser minds: half a character
        return ImpastoError(f"is not JSON: {message.removeprefix('Invalid JSON: ')}", where=where)
    expected = message.removeprefix("Input should be ").removeprefix("Value error, ")
    return ImpastoError(
        f"{_short(finding['input'])} is not allowed",
        where=f"{where}: {key}" if key else where,
        expected=expected[:1].lower() + expected[1:],
        fix=fix,
    )


def _object(pairs: list[tuple[str, Any]]) -> _Object:
    result = _Object(pairs)
    if len(result) < len(pairs):
        seen: set[str] = set()
        result.repeated = next(k for k, _ in pairs if k in seen or seen.add(k))  # type: ignore[func-returns-value]
    return result


def _check_values(value: Any, where: str, key: str, depth: int) -> None:
    """Find repeated keys, numbers that are not finite, and too much depth."""
    if depth > MAX_DEPTH:
        raise _too_deep(f"{where}: {key[:80]}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ImpastoError(f"{value} is not a number", where=f"{where}: {key}")
    if isinstance(value, dict):
        if isinstance(value, _Object) and value.repeated is not None:
            raise ImpastoError(
                "the key is given twice",
                where=f"{where}: {_join(key, value.repeated)}",
                fix="keep one of the two",
            )
        for name, item in value.items():
            _check_values(item, where, _join(key, name), depth + 1)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            _check_values(item, where, f"{key}[{i}]", depth + 1)


def _key(location: tuple[int | str, ...], document: Any) -> str:
    """Write a place as ``photos[3].exposure_s``, leaving out pydantic's names of union members."""
    key = ""
    if location and location[-1] == "[key]":  # the name of an entry is wrong, not its value
        location = location[:-2]
    for part in location:
        if isinstance(part, int):
            key += f"[{part}]"
            document = document[part] if _has(document, part) else None
            continue
        if isinstance(document, dict) and part not in document and part == document.get("type"):
            continue
        key = _join(key, part)
        document = document.get(part) if isinstance(document, dict) else None
    return key


def _has(document: Any, index: int) -> bool:
    return isinstance(document, list) and index < len(document)


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _short(value: Any) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."


def _too_deep(where: str) -> ImpastoError:
    return ImpastoError(f"is nested more than {MAX_DEPTH} levels deep", where=where)
