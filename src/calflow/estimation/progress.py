"""Progress reports of long computations, and a random generator for each purpose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Say = Callable[[str], None]  # receives a line of text
Advance = Callable[[float], None]  # receives the share of work done
Draws = Callable[[str], np.random.Generator]  # returns the generator for a purpose


def nobody(_: object) -> None:
    """Ignore the report."""


def onward(advance: Advance) -> Advance:
    """Return a callback that passes on the largest share so far, so that progress never falls."""
    furthest = 0.0

    def never_falling(share: float) -> None:
        nonlocal furthest
        furthest = max(furthest, share)
        advance(furthest)

    return never_falling


def draws(seed: int) -> Draws:
    """Return a random generator for each purpose from one seed, so that no purpose's draws depend on another's."""
    return lambda purpose: np.random.default_rng([seed, *purpose.encode()])


SAME: Draws = draws(1)  # the default where no seed is given
