"""Effects: physical causes by which a real robot departs from its nominal model, one cause per file."""

from calflow.effects.base import Effect, catalogue, effect_class, effect_ids, effects_by_id, effects_given

__all__ = ["Effect", "catalogue", "effect_class", "effect_ids", "effects_by_id", "effects_given"]
