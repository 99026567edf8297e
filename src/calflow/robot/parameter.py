"""A parameter: a bounded decision variable of the graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from calflow.robot.parts import Expected


@dataclass(frozen=True)
class Parameter:
    """A bounded decision variable (SI units); at its nominal value the effect is absent.

    The prior is normal with mean prior_mean, the nominal value unless the robot file knows better, and standard deviation
    prior_sd, cut at the bounds. Parameters of one part stand and fall together; joint is the number of the joint or link that
    it belongs to, 0 for none. figure is the maker's figure that the parameter's value is added to, for tables that show the
    sum; meaning says in words what it is. Effect, variant, part and symbol are a parameter's identity: no two of a model share
    it, nor a name. The part of the model that declares it sets variant and tag, which stands between part and symbol in the
    name.
    """

    effect: str
    part: str
    symbol: str
    unit: str
    prior_sd: float
    lower: float
    upper: float
    nominal: float = 0.0
    figure: float = 0.0
    meaning: str = ""
    joint: int = 0
    variant: str = ""
    tag: str = ""
    prior_mean: float = 0.0

    @property
    def identity(self) -> tuple[str, str, str, str]:
        """What it is known by: effect, variant, part and symbol."""
        return self.effect, self.variant, self.part, self.symbol

    @property
    def name(self) -> str:
        """The name that tables show, e.g. `joint2.alpha` or `joint3.joint-eccentricity[order 2].cos`."""
        return ".".join(filter(None, (self.part, self.tag, self.symbol)))

    def as_expected(self, known: Mapping[tuple[str, str, str, str], Expected]) -> Parameter:
        """Return it with the mean and standard deviation that are expected of it, where any are."""
        own = known.get(self.identity)
        return self if own is None else replace(self, prior_mean=own.mean, prior_sd=own.sd)
