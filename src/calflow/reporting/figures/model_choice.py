"""Figure of how probable causes are, among the models that may be right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from calflow.reporting.style import DARK, MIDDLE, figure

ROW = 0.2  # inches of a cause


def cause_probabilities(names: Sequence[str], probability: np.ndarray, by_tests: np.ndarray) -> Figure:
    """Draw each cause's probability (n_causes,), and beside it what the tests of diagnose made it."""
    drawn = figure(0.9 + ROW * len(names))
    axes = drawn.subplots()
    place = np.arange(len(names))
    axes.hlines(
        place, np.minimum(probability, by_tests), np.maximum(probability, by_tests), color=MIDDLE, linewidth=0.8
    )
    axes.plot(
        by_tests,
        place,
        "o",
        markerfacecolor="white",
        color=DARK,
        label="by the linear tests of diagnose",
        clip_on=False,
    )
    axes.plot(probability, place, "o", color=DARK, label="probability", clip_on=False)
    axes.set_yticks(place, names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0, 1)
    axes.set_xlabel("probability that it acts")
    drawn.legend(ncols=2, loc="outside upper center")
    return drawn
