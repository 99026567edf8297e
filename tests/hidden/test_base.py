"""A foot that rocks on loose bolts is hidden in data of the independent simulator, and `calflow run` has to find it."""

from __future__ import annotations

import pytest

from hidden.causes import Hidden
from hidden.test_hidden import case, found, only

ALIKE = only("base-play", "base-compliance", "axis-wobble", "bearing-compliance", "joint-error-map", "link-torsion")
LOOSE, SOFT = Hidden("base-play", 0, 4e-4), Hidden("base-compliance", 0, 3e-8, 0.3)


@pytest.mark.parametrize(("robot", "hidden"), [("serial", LOOSE), ("hh800", LOOSE), ("hh800", SOFT)])
def test_a_loose_foot_is_told_from_a_soft_one(robot, hidden, tmp_path):
    """Fails if rocking is taken for a bearing that wobbles or a soft foundation for play, or one is found as several."""
    seen = found(tmp_path, case(robot, hidden, settings=ALIKE), 31)
    assert len(seen.causes) == 1, seen.causes
    assert seen.has(hidden.cause)
    assert seen.unexplained.empty, seen.unexplained
