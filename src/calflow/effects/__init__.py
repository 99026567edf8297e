"""Effects: what a real robot also does, one physical cause per file."""

from __future__ import annotations

import importlib
import pkgutil
from functools import lru_cache

from calflow.effects.base import Effect

__all__ = ["Effect", "catalogue"]


@lru_cache
def catalogue() -> dict[str, type[Effect]]:
    """Return every effect by its id; a new file in this folder is enough to add one."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    here = [
        effect
        for effect in _kinds(Effect)  # type: ignore[type-abstract]
        if effect.__module__.startswith(f"{__name__}.") and isinstance(getattr(effect, "id", None), str)
    ]
    return {effect.id: effect for effect in sorted(here, key=lambda effect: effect.id)}


def _kinds(of: type[Effect]) -> list[type[Effect]]:
    return [kind for direct in of.__subclasses__() for kind in (direct, *_kinds(direct))]
