"""Progress and chance of long work: who is told how it goes on, and a random generator for each purpose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Say = Callable[[str], None]  # tells a line
Advance = Callable[[float], None]  # tells the share of work done
Draws = Callable[[str], np.random.Generator]  # a generator by what it is for


def nobody(_: object) -> None:
    """Tell nobody."""


def onward(advance: Advance) -> Advance:
    """Return advance for shares that may fall: it is told the largest so far."""
    furthest = 0.0

    def never_falling(share: float) -> None:
        nonlocal furthest
        furthest = max(furthest, share)
        advance(furthest)

    return never_falling


def draws(seed: int) -> Draws:
    """Return a random generator for each purpose from one seed, so that no purpose's draws depend on another's."""
    return lambda purpose: np.random.default_rng([seed, *purpose.encode()])


SAME: Draws = draws(1)  # where nobody gives a seed: the same draws each time
