"""The catalogue for some data: every effect in the forms that they can show, and why others cannot be tested."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from calflow.effects import Effect, catalogue, effect_class
from calflow.effects.cause import parts
from calflow.measurements.measurements import Measurements


@dataclass(frozen=True)
class Catalogue:
    """The effects to look for in some data, every variant, and why others are not tested.

    lacking says by id what the data lack, superseded why an effect is not needed for this robot.
    """

    effects: tuple[Effect, ...]
    lacking: dict[str, str]
    superseded: dict[str, str] = field(default_factory=dict)

    @cached_property
    def variants(self) -> dict[tuple[str, str], int]:
        """How many forms there are for each place."""
        return dict(Counter((effect.id, part) for effect in self.effects for part in parts(effect)))

    def untestable(self, cause: str) -> dict[str, str]:
        """Return what the data could not test though it may be behind a cause (id) that was found: ids, and what each needs."""
        kind = effect_class(cause)
        alike = kind.alike if kind else ()
        lacking = ((name, effect_class(name), why) for name, why in self.lacking.items())
        return {name: why for name, other, why in lacking if name in alike or (other and cause in other.taken_for)}

    @staticmethod
    def of(data: Measurements, have: Sequence[str], only: Sequence[str] = (), without: Sequence[str] = ()) -> Catalogue:
        """Collect what can be tested on these training data: all, or only some, but what the model has already."""
        effects: list[Effect] = []
        lacking, superseded = {}, {}
        named = {name: kind for name in only if (kind := effect_class(name))}
        for name, kind in sorted((catalogue() | named).items()):
            if name in have or name in without or (only and name not in only):
                continue
            if reason := kind.superseded(data.robot):
                superseded[name] = reason
            elif reason := kind.lacking(data.robot, data):
                lacking[name] = reason
            elif not kind.is_noise():
                effects += kind.variants(data.robot, data)
        return Catalogue(tuple(effects), lacking, superseded)
