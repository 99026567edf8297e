"""Play in the bearings of a loop's rod is hidden in data of the independent simulator, and `calflow run` has to find it."""

from __future__ import annotations

import pytest

from hidden.causes import Hidden
from hidden.test_hidden import case, found, only

ALIKE = only(
    "rod-play", "torque-backlash", "nonlinear-joint-stiffness", "payload-mass", "payload-com", "joint-eccentricity"
)


@pytest.mark.parametrize("hidden", [Hidden("rod-play", 3, 3e-4), Hidden("torque-backlash", 3, 4e-4)])
def test_play_of_the_rod_is_told_from_that_of_the_gear(hidden, tmp_path):
    """Fails if a worn rod is called a gear or a drive, or a worn gear a rod: the crank's weight loads the gear alone."""
    seen = found(tmp_path, case("hh800", hidden, counterweight=True, settings=ALIKE), 32)
    assert len(seen.causes) == 1, seen.causes
    assert seen.has(hidden.cause, 3)
    assert seen.unexplained.empty, seen.unexplained
