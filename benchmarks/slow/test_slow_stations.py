"""Which of several devices stands elsewhere or measures wrongly, and what is known of it before and after: at length."""

from __future__ import annotations

import pytest

from effects import test_frame_step, test_session_frame, test_tracker_scale
from hidden.test_steps import assert_predicted_as_of_then


def test_of_two_stations_in_turn_the_one_that_moved_is_told(tmp_path):
    """Fails if one of two stations in turn moves the other too."""
    test_frame_step.assert_told_in_turn(tmp_path, "of station B")


def test_a_wire_that_stands_elsewhere_leaves_the_tracker_where_it_is(tmp_path):
    """Fails if a wire's anchor that was moved is taken for a tracker set up anew, or for a robot that moved."""
    test_session_frame.assert_told(tmp_path, "of wire")


@pytest.mark.parametrize("anchor_known", [True, False])
def test_the_zero_of_a_wire_is_told(anchor_known, tmp_path):
    """Fails if a wire's wrong zero is taken for a cause of the robot, or bends it, whether or not its anchor's place is known."""
    test_tracker_scale.assert_told(tmp_path, 0.0, 1.2e-3, anchor_known)


def test_a_row_that_states_a_time_is_predicted_by_the_tool_of_then(tmp_path):
    """Fails if a tool before its slip is predicted as it was left, after it or without a time as before it."""
    assert_predicted_as_of_then(tmp_path, "tool-slip")
