"""Effects as files state them: by their ids, checked as the file is read."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from calflow.effects.base import effects_given
from calflow.files.problems import InputError


def known_effects(effects: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ids of effects if they are valid.

    Raises:
        ValueError: one of them is unknown or given twice, or there are none.
    """
    try:
        effects_given(effects)
    except InputError as error:
        raise ValueError("; ".join(problem.message for problem in error.problems)) from None
    if not effects or len(set(effects)) < len(effects):
        raise ValueError("expected at least one effect, and each once")
    return effects


Effects = Annotated[tuple[str, ...], AfterValidator(known_effects)]
AnyEffects = Annotated[tuple[str, ...], AfterValidator(lambda effects: effects and known_effects(effects))]  # or none
