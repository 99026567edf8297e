"""A link's twist is hidden in data of the independent simulator, and `calflow run` has to find it."""

from __future__ import annotations

from dataclasses import replace

from hidden.causes import Hidden
from hidden.test_hidden import case, found, only

ALIKE = only("link-torsion", "link-bending", "bearing-compliance", "axis-wobble", "joint-error-map")


TWISTED = {  # the first is found here, both by benchmarks/hidden_cases.py
    "to the wrist": case("hh800", Hidden("link-torsion", 3, 3e-7, "to the wrist")),
    "to the elbow": case("hh800", Hidden("link-torsion", 2, 3e-7)),
}


def test_a_link_that_twists_as_far_as_the_wrist_is_one_cause(tmp_path):
    """Fails if a forearm that ends at the wrist is found as a link that bends and a bearing that tilts."""
    seen = found(tmp_path, replace(TWISTED["to the wrist"], settings=ALIKE), 33)
    assert len(seen.causes) == 1, seen.causes
    assert seen.has("link-torsion", 3)
    assert seen.unexplained.empty, seen.unexplained
