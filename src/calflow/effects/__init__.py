"""Effects: what a real robot also does, one physical cause per file."""

from __future__ import annotations

import importlib
import pkgutil
from functools import lru_cache

from calflow.effects.base import Effect
from calflow.effects.needs import NEEDS
from calflow.files import plugins
from calflow.files.problems import nearest

__all__ = ["Effect", "catalogue"]


@lru_cache
def catalogue() -> dict[str, type[Effect]]:
    """Return every effect by its id: a new file in this folder is enough to add one, or another package's entry point.

    Raises:
        InputError: another package brings what cannot be used.
    """
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    here = [
        effect
        for effect in _kinds(Effect)  # type: ignore[type-abstract]
        if effect.__module__.startswith(f"{__name__}.") and isinstance(getattr(effect, "id", None), str)
    ]
    own = {effect.id: effect for effect in here}
    others = plugins.found(plugins.EFFECTS, Effect, own, _flaw)  # type: ignore[type-abstract]
    return dict(sorted((own | others).items()))


def _flaw(effect: type[Effect]) -> str:
    """What an effect of another package says of itself that calflow cannot do with."""
    if "{id}" not in effect.tag:
        return "its tag lacks {id}, so that its parameters' names are not its own"
    unknown = [f"'{need}'{nearest(need, NEEDS)}" for need in effect.needs if need not in NEEDS]
    return f"it needs {' and '.join(unknown)}; expected some of {', '.join(NEEDS)}" if unknown else ""


def _kinds(of: type[Effect]) -> list[type[Effect]]:
    return [kind for direct in of.__subclasses__() for kind in (direct, *_kinds(direct))]
