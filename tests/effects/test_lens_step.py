"""Steps of a lens: hidden in photographs that are larger from an image on."""

from __future__ import annotations

import numpy as np
import pytest

from effects.test_camera_slip import BOARD, findings
from observations.photographed import UR5E, photographed


def test_a_lens_that_was_touched_is_no_camera_that_slipped(tmp_path):
    """Fails if longer focal lengths from an image on are taken for a camera that moved, or are of another size."""
    made, longer = photographed(UR5E, True, 30, np.random.default_rng(8), points=BOARD), 4e-3
    after = (made.rows["pose"] > 19).to_numpy()
    for name, centre in zip(("u_px", "v_px"), made.lens.centre, strict=True):
        made.rows[name] += longer * (made.rows[name] - centre) * after
    found = findings(tmp_path, made).set_index("cause")
    assert [*found.index] == ["lens-step"]
    only = found.loc["lens-step"]
    assert only["status"] == "named"
    assert f"after the image of pose {made.rows.loc[~after, 'pose'].max()})" in only["statement"]
    assert only["estimate"] == pytest.approx(longer, abs=4 * only["sd"])
