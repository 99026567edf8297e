"""A hypothesis: what a test needs to know of a possible cause, whatever it is a cause of."""

from __future__ import annotations

from typing import Protocol, Self, TypeVar

import numpy as np


class Hypothesis(Protocol):
    """A possible cause in one of its forms. Two that are equal are the same cause in the same form."""

    @property
    def id(self) -> str:
        """What kind of cause it is."""
        ...

    @property
    def part(self) -> str:
        """Where it acts; may be empty."""
        ...

    @property
    def joint(self) -> int:
        """Number of the joint or link where it acts, 0 for none."""
        ...

    @property
    def place(self) -> tuple[str, str]:
        """What stays the same in all its variants: id and part."""
        ...

    @property
    def detail(self) -> str:
        """Its variant in words; empty where there is only one."""
        ...

    @property
    def n_parameters(self) -> int:
        """How many parameters it has."""
        ...

    @property
    def bounds(self) -> np.ndarray:
        """Least and largest values of its parameters, from nominal, shape (2, n_parameters)."""
        ...

    @property
    def family(self) -> str:
        """What to call it where the data do not tell it from others of its family; may be empty."""
        ...

    @property
    def alike(self) -> tuple[str, ...]:
        """Ids of what no data of this kind tell from it."""
        ...

    def same_form(self, other: Self) -> bool:
        """Whether it and another are forms of the same thing, so that they cannot both act."""
        ...


H = TypeVar("H", bound=Hypothesis)
