"""``--set stage.key=value``: values for the stages' configurations."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel, ValidationError

from pipeline.engine.recipe import Recipe
from pipeline.engine.stage import Stage
from pipeline.errors import UsageError

Settings = dict[str, dict[str, Any]]
"""Values by key, by stage."""


def parse_settings(texts: Iterable[str], recipe: Recipe) -> Settings:
    """Parse ``stage.key=value``; a value is TOML or JSON, else a plain string. The last wins.

    Raises
    ------
    UsageError
        It is not of that form, or names no stage of the recipe.
    """
    names = [reference.name for reference in recipe]
    settings: Settings = {}
    for text in texts:
        target, equals, value = text.partition("=")
        stage, dot, key = target.strip().partition(".")
        if not (equals and dot and stage and key):
            raise UsageError(f"--set {text}: not understood", expected="stage.key=value")
        if stage not in names:
            raise UsageError(
                f"--set {text}: no stage {stage!r}", expected=f"one of {', '.join(names)}"
            )
        settings.setdefault(stage, {})[key] = _parse_value(value.strip())
    return settings


def _parse_value(text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {text}")
        if parsed.keys() == {"value"}:
            return parsed["value"]
    except tomllib.TOMLDecodeError:
        pass
    try:
        return json.loads(text)
    except ValueError:
        return text


def configure(stage: Stage, settings: Settings) -> BaseModel:
    """Return the stage's configuration: its defaults and what was set.

    Raises
    ------
    UsageError
        A key is unknown or a value out of bounds.
    """
    values = settings.get(stage.name, {})
    known = stage.config.model_fields
    for key in values:
        if key not in known:
            allowed = ", ".join(known) or "nothing: this stage has no configuration"
            raise UsageError(f"--set {stage.name}.{key}: no such key", expected=f"one of {allowed}")
    try:
        return stage.config.model_validate(values)
    except ValidationError as error:
        problems = [
            f"--set {'.'.join((stage.name, *map(str, problem['loc'])))}: "
            f"{problem['msg']}, given {problem['input']!r}"
            for problem in error.errors()
        ]
        raise UsageError("; ".join(problems)) from None
