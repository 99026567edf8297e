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
    sum; meaning says in words what it is. One that is held has the value held, and is no variable. Effect, variant, part and
    symbol are a parameter's identity: no two of a model share it, nor a name. The part of the model that declares it sets
    variant and tag, which stands between part and symbol in the name.
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
    held: float | None = None

    @property
    def identity(self) -> tuple[str, str, str, str]:
        """What it is known by: effect, variant, part and symbol."""
        return self.effect, self.variant, self.part, self.symbol

    @property
    def name(self) -> str:
        """The name that tables show, e.g. `joint2.alpha` or `joint3.joint-eccentricity[order 2].cos`."""
        return ".".join(filter(None, (self.part, self.tag, self.symbol)))

    def as_expected(self, expected: Mapping[str | tuple[str, str, str, str], Expected]) -> Parameter:
        """Return it with what is stated of it, where anything is, by its identity and then by its name."""
        parameter = self
        for key in (self.identity, self.name):
            if stated := expected.get(key):
                parameter = parameter._stated(stated)
        return parameter

    def _stated(self, by: Expected) -> Parameter:
        return replace(
            self,
            prior_mean=_either(by.mean, self.prior_mean),
            prior_sd=_either(by.sd, self.prior_sd),
            lower=_either(by.lower, self.lower),
            upper=_either(by.upper, self.upper),
            held=_either(by.value, self.nominal) if by.fixed else None,
        )

    def contradiction(self, by: Expected) -> str:
        """Say why it cannot be as it is stated; empty where it can."""
        after = self._stated(by)
        lower, upper = after.lower, after.upper
        if by.unit not in ("", self.unit):
            return f"parameter '{self.name}' is in {self.unit}, not {by.unit}"
        if lower >= upper:
            return f"parameter '{self.name}': expected lower < upper, found {lower:g} and {upper:g} {self.unit}"
        for value in (by.mean, after.held):
            if value is not None and not lower <= value <= upper:
                return f"parameter '{self.name}' is between {lower:g} and {upper:g} {self.unit}, expected {value:g}"
        if by.mean is None and after.held is None and not lower <= after.prior_mean <= upper:
            return (f"parameter '{self.name}' is expected about {after.prior_mean:g} {self.unit}, which is not between "
                    f"{lower:g} and {upper:g}: expected a prior's mean that is")  # fmt: skip
        return ""


def _either(stated: float | None, otherwise: float) -> float:
    return otherwise if stated is None else stated
