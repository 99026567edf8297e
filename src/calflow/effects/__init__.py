"""Effects: what a real robot also does, one physical cause per file."""

from __future__ import annotations

from functools import lru_cache

from calflow.effects.base import NEEDS, Effect
from calflow.files import plugins
from calflow.files.problems import nearest

__all__ = ["Effect", "catalogue"]


@lru_cache
def catalogue() -> dict[str, type[Effect]]:
    """Return every effect by its id: a new file in this folder is enough to add one, or another package's entry point.

    Raises:
        InputError: another package brings what cannot be used.
    """
    return plugins.catalogue(__name__, plugins.EFFECTS, Effect, _flaw)  # type: ignore[type-abstract]


def _flaw(effect: type[Effect]) -> str:
    """What an effect of another package says of itself that calflow cannot do with."""
    if "{id}" not in effect.tag:
        return "its tag lacks {id}, so that its parameters' names are not its own"
    unknown = [f"'{need}'{nearest(need, NEEDS)}" for need in effect.needs if need not in NEEDS]
    return f"it needs {' and '.join(unknown)}; expected some of {', '.join(NEEDS)}" if unknown else ""
