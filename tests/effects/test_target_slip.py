"""A board that slipped (`target-slip`), hidden in photographs by physics of their own; its null is the camera's."""

from __future__ import annotations

from dataclasses import replace

from effects.test_camera_slip import BEFORE, SLIP, assert_slipped, slipped


def test_a_board_that_slipped_is_not_a_camera_that_did(tmp_path):
    """Fails if a board's slip is missed, taken for the camera's, put within an image, or is of another size than the board's."""
    made = slipped(7, target=SLIP)
    named = replace(made, rows=made.rows.assign(image=[f"board_{pose:02d}.png" for pose in made.rows["pose"]]))
    assert_slipped(tmp_path, named, "target-slip", f"image board_{BEFORE}.png")
