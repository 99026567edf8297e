"""A foot that rocks on loose bolts, or a worn bearing, is hidden in the simulator's data, and `calflow run` has to find it."""

from __future__ import annotations

from dataclasses import replace

from hidden.causes import Hidden
from hidden.test_hidden import case, found, only

ALIKE = only(
    "base-play",
    "base-compliance",
    "axis-wobble",
    "bearing-compliance",
    "bearing-play",
    "joint-error-map",
    "link-torsion",
)
LOOSE, SOFT = Hidden("base-play", 0, 4e-4), Hidden("base-compliance", 0, 3e-8, 0.3)


FEET = {"loose": case("serial", LOOSE), "loose, loop": case("hh800", LOOSE), "soft, loop": case("hh800", SOFT)}


def test_a_loose_foot_is_told_from_a_soft_one(tmp_path):
    """Fails if rocking is taken for a bearing that wobbles or a soft foundation; benchmarks/hidden_cases.py has all feet."""
    seen = found(tmp_path, replace(FEET["loose"], settings=ALIKE), 31)
    assert len(seen.causes) == 1, seen.causes
    assert seen.has("base-play")
    assert seen.unexplained.empty, seen.unexplained


BEARINGS = {joint: case("serial", Hidden("bearing-play", joint, 4e-4)) for joint in (1, 4)}


def test_a_worn_bearing_is_told_from_a_soft_one_and_from_a_loose_foot(tmp_path):
    """Fails if a bearing that lies against one side or the other is taken for a foot that rocks, or for several soft bearings."""
    seen = found(tmp_path, replace(BEARINGS[1], settings=ALIKE), 31)
    assert len(seen.causes) == 1, seen.causes
    assert seen.has("bearing-play", 1)
