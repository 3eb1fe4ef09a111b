"""A recipe: the stages in the order they run, imported when they are needed."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pipeline.errors import ImpastoError, UsageError

if TYPE_CHECKING:
    from pipeline.engine.stage import Stage


@dataclass(frozen=True)
class StageReference:
    """Where a stage is declared (``module:attribute``) and the folder it fills in a workspace."""

    name: str
    target: str
    folder: str

    def load(self) -> Stage:
        """Import the stage.

        Raises
        ------
        ImpastoError
            Its module, or the constant in it, does not exist.
        """
        module_name, _, attribute = self.target.partition(":")
        try:
            module = importlib.import_module(module_name)
        except ModuleNotFoundError as error:
            if error.name is None or not (module_name + ".").startswith(error.name + "."):
                raise
            raise ImpastoError(f"the stage {self.name} is not installed ({error})") from error
        stage: Stage = getattr(module, attribute)
        if (stage.name, stage.folder) != (self.name, self.folder):
            raise TypeError(f"{self.target} is {stage.name} in {stage.folder}/, not {self}")
        return stage


Recipe = tuple[StageReference, ...]


def between(recipe: Recipe, first: str | None, last: str | None) -> Recipe:
    """Return the part of the recipe from ``first`` to ``last``, both included.

    Raises
    ------
    UsageError
        A name is not in the recipe, or ``first`` comes after ``last``.
    """
    names = [reference.name for reference in recipe]
    for option, name in (("--from", first), ("--to", last)):
        if name is not None and name not in names:
            raise UsageError(f"{option}: no stage {name!r}", expected=f"one of {', '.join(names)}")
    start = names.index(first) if first is not None else 0
    stop = names.index(last) if last is not None else len(names) - 1
    if start > stop:
        raise UsageError(
            f"--from {first} comes after --to {last}", expected=f"the order {', '.join(names)}"
        )
    return recipe[start : stop + 1]
