"""A board that slipped (`target-slip`), hidden in photographs by physics of their own; its null is the camera's."""

from __future__ import annotations

from effects.test_camera_slip import SLIP, assert_slipped, slipped


def test_a_board_that_slipped_is_not_a_camera_that_did(tmp_path):
    """Fails if a board's slip is missed, taken for the camera's, put within an image, or is of another size than the board's."""
    assert_slipped(tmp_path, slipped(7, target=SLIP), "target-slip")
