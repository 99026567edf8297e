"""The figure of two series: turning joints in degrees and microradians, slides in millimetres and micrometres."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calflow.reporting.sections.confirmation import _faults, two_series


def test_a_slides_curve_is_drawn_in_lengths():
    """Fails if a slide's curve is left out beside a turning joint's, or labelled as an angle."""
    x = np.linspace(0, 1, 5)
    turning = pd.DataFrame(
        {"cause": "joint-error-map", "joint": 2, "travel": 90 * x, "here": x, "there": x, "travel_unit": "deg"}
    )
    sliding = pd.DataFrame({"cause": "gear-transmission-error", "joint": 1, "travel": 500 * x, "here": 20 * x,
                            "there": 30 * x, "travel_unit": "mm"})  # fmt: skip
    axes = [one for one in two_series(pd.concat([turning, sliding], ignore_index=True)).axes if one.get_visible()]
    assert [(one.get_xlabel(), one.get_ylabel()) for one in axes] == [
        ("angle [deg]", "error [µrad]"),
        ("position [mm]", "error [µm]"),
    ]
    assert [max(line.get_ydata()) for line in axes[1].get_lines()] == [20, 30]
    assert max(axes[1].get_lines()[0].get_xdata()) == 500


def test_what_was_wrong_in_the_other_file_is_told_once():
    """Fails if the reader is not told that the other series' file is to be corrected, or is told of each line."""
    faults = pd.DataFrame({"statement": ["the sign of q3 is turned"] * 2 + ["line 9 is far off"]})
    (block,) = _faults(faults)
    assert "the sign of q3 is turned; line 9 is far off. Correct that file too." in str(block)
    assert _faults(faults.iloc[:0]) == _faults(None) == []
