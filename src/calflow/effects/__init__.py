"""Effects: what a real robot also does, one physical cause per file."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Sequence
from functools import lru_cache

from calflow.effects.base import NEEDS, Effect
from calflow.files import plugins
from calflow.files.problems import InputError, Problem, nearest

__all__ = ["Effect", "catalogue", "effect_class", "effect_ids", "effects_given"]


@lru_cache
def catalogue() -> dict[str, type[Effect]]:
    """Return every effect by its id: a new file in this folder is enough to add one, or another package's entry point.

    Raises:
        InputError: another package brings what cannot be used.
    """
    return plugins.catalogue_of(__name__, plugins.EFFECTS, Effect, _flaw)  # type: ignore[type-abstract]


def effect_class(effect: str) -> type[Effect] | None:
    """Return the effect of an id: the catalogue's, else the class that a program or a notebook has defined last, if any."""
    every = plugins.subclasses(Effect)  # type: ignore[type-abstract]
    defined = [kind for kind in every if not kind.__module__.startswith("calflow.")]
    return catalogue().get(effect) or next((kind for kind in defined[::-1] if getattr(kind, "id", "") == effect), None)


def effects_given(effects: Iterable[object]) -> tuple[str | type[Effect] | Effect, ...]:
    """Return effects that are given by id, as a class or as an object, as they are.

    Raises:
        InputError: with all that is no effect, or cannot be used.
    """
    given = list(effects)
    if wrong := [
        Problem(message, key=f"effects[{k + 1}]") for k, one in enumerate(given) if (message := _unusable(one))
    ]:
        raise InputError(wrong)
    return tuple(given)  # type: ignore[arg-type]


def effects_by_id(effects: Iterable[object]) -> tuple[str, ...]:
    """Return the ids of effects that are given as of `effects_given`, by which each is found again.

    Raises:
        InputError: as of `effects_given`; or an id leads to another class, which was defined later.
    """
    given = effects_given(effects)
    if wrong := [
        Problem(f"the id '{kind.id}' of {kind.__name__} is taken by {effect_class(kind.id)!r}", key=f"effects[{k + 1}]")
        for k, kind in enumerate(given) if inspect.isclass(kind) and effect_class(kind.id) is not kind
    ]:  # fmt: skip
        raise InputError(wrong)
    return effect_ids(given)


def effect_ids(effects: Sequence[str | type[Effect] | Effect]) -> tuple[str, ...]:
    """Return the effects' ids."""
    return tuple(one if isinstance(one, str) else one.id for one in effects)


def _unusable(given: object) -> str:
    """What keeps something from being used as an effect; empty where nothing does."""
    if isinstance(given, str):
        return "" if effect_class(given) else f"unknown effect '{given}'{nearest(given, catalogue())}"
    kind = given if inspect.isclass(given) else type(given)
    if not issubclass(kind, Effect):
        return f"expected the id of an effect, a subclass of calflow.effects.base.Effect or an object of one, found {given!r}"
    if lacking := sorted(getattr(kind, "__abstractmethods__", ())):
        return f"{kind.__name__} lacks {', '.join(lacking)}"
    if lacking := [name for name in ("id", "title") if not isinstance(getattr(kind, name, None), str)]:
        return f"{kind.__name__} lacks {' and '.join(lacking)}: expected texts"
    if catalogue().get(kind.id, kind) is not kind:
        return f"the id '{kind.id}' of {kind.__name__} is taken by {catalogue()[kind.id]!r}"
    return "" if kind.id in catalogue() else _flaw(kind)


def _flaw(effect: type[Effect]) -> str:
    """What an effect of another package says of itself that calflow cannot do with."""
    if "{id}" not in effect.tag:
        return "its tag lacks {id}, so that its parameters' names are not its own"
    unknown = [f"'{need}'{nearest(need, NEEDS)}" for need in effect.needs if need not in NEEDS]
    return f"it needs {' and '.join(unknown)}; expected some of {', '.join(NEEDS)}" if unknown else ""
