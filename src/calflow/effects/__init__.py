"""Effects: what a real robot also does, one physical cause per file."""

from calflow.effects.base import Effect, catalogue, effect_class, effect_ids, effects_by_id, effects_given

__all__ = ["Effect", "catalogue", "effect_class", "effect_ids", "effects_by_id", "effects_given"]
