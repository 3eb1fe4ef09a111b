"""The commands with the toy recipe."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import pytest


class Ended(NamedTuple):
    """What a command left."""

    status: int
    out: str
    err: str


@pytest.fixture
def impasto(
    toy: ModuleType, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., Ended]:
    """Call the command line in this process, with the toy recipe."""
    import pipeline.commands.run
    import pipeline.commands.stage
    import pipeline.commands.status
    from pipeline.cli import main

    for module in (pipeline.commands.run, pipeline.commands.stage, pipeline.commands.status):
        monkeypatch.setattr(module, "RECIPE", toy.RECIPE)

    def call(*arguments: object) -> Ended:
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        assert isinstance(ended.value.code, int)
        return Ended(ended.value.code, *capfd.readouterr())

    return call
