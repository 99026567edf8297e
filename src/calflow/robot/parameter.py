"""A parameter: a bounded decision variable of the graph."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """A bounded decision variable (SI units); at its nominal value the effect is absent.

    The prior is normal about the nominal value with standard deviation prior_sd, cut at the bounds. Parameters of one
    part stand and fall together; joint is the number of the joint or link that it belongs to, 0 for none. figure is the
    maker's figure that the parameter's value is added to, for tables that show the sum; meaning says in words what it is.
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

    @property
    def name(self) -> str:
        """The name that tables show, e.g. `joint2.alpha`."""
        return f"{self.part}.{self.symbol}"
