"""A print that is longer one way (`print-scale`), hidden in photographs by physics of their own."""

from __future__ import annotations

import pytest

from effects.boards import BOARD, findings_of, of_plate


def test_a_print_that_is_longer_one_way_is_findings_of(tmp_path):
    """Fails if a stretched print is missed, or the stretch is not how much longer it is one way than the other."""
    only = findings_of(tmp_path, of_plate(12, BOARD * [1.0, 1.003, 1.0]))
    assert [*only.index] == ["print-scale"]
    assert only.loc["print-scale", "estimate"] == pytest.approx(3e-3, abs=4 * only.loc["print-scale", "sd"])
    assert only.loc["print-scale", "sd"] < 3e-4


def test_a_print_that_is_too_large_all_over_is_not_told_from_longer_links(tmp_path):
    """Fails if a cause is named for what any camera sees alike: a larger print before a larger robot.

    Or if the errors of a worn arm are taken for a bowed board, or a slip of board or camera.
    """
    assert findings_of(tmp_path, of_plate(13, BOARD * [1.003, 1.003, 1.0])).empty
