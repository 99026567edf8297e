"""Configuration: flags tell postures as the makers' manuals do, and change only where a correction crosses a boundary."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.programs.target import ArmPosture, FanucConfiguration, Flag, KrlConfiguration, RapidConfiguration


def posture(*degrees, front=True, elbow=True):
    return ArmPosture(tuple(np.deg2rad(degrees)), front, elbow)


def flags(*texts):
    return tuple(Flag(10 * k, 10 * k + len(text), text) for k, text in enumerate(texts))


@pytest.mark.parametrize(
    ("configuration", "meant", "other"),
    [
        (RapidConfiguration(flags("0", "-1", "2", "1")), posture(10, 0, 0, -10, -30, 190), posture(10, 0, 0, -10, 30, 190)),
        (RapidConfiguration(flags("-1", "0", "0", "6")), posture(-10, 0, 0, 5, 30, 9, front=False, elbow=False),
         posture(-10, 0, 0, 5, 30, 9, front=False)),
        (KrlConfiguration(flags("2", "35"), ("S", "T")), posture(-10, -90, 90, 10, 15, -5), posture(10, -90, 90, 10, 15, -5)),
        (KrlConfiguration(flags("6", "27"), ("S", "T")), posture(-10, -90, 90, -10, -15, 5), posture(-10, -90, 90, -10, 15, 5)),
        (KrlConfiguration(flags("'B010'", "'B000010'"), ("S", "T")), posture(1, -90, 90, 0.01, 15, -0.01),
         posture(1, -90, 90, 1, 15, 1, elbow=False)),
        # the same place of an R-2000iB/165F with NUT 000 and FUT 000, as its controller shows
        (FanucConfiguration(flags("N", "U", "T", "0", "0", "0")), posture(7.962, -5.284, -36.25, 77.661, -51.975, -79.273),
         posture(7.962, -5.284, -36.25, -102.339, 51.975, 100.727)),
        (FanucConfiguration(flags("F", "U", "T", "0", "1", "-1")), posture(8, 0, 0, 200, 30, -200), posture(8, 0, 0, 9, 30, 9)),
    ],
)  # fmt: skip
def test_flags_tell_their_posture(configuration, meant, other):
    """Fails if a posture is taken for another, or a flag's boundary is not where the maker has it."""
    assert configuration.agrees(meant)
    assert not configuration.agrees(other)
    assert configuration.changes(meant, meant) == ()


def test_turn_and_status_as_worked_out_by_hand():
    """Fails if T's bits are in another order, a joint at 0 counts as negative, or S tells of another joint than A5.

    The readings and their T of 18 are an example that integrators of KUKA work out on their forum, with the rule that S has its
    third bit where A5 is at least -180 and below 0 degrees.
    """
    readings = posture(91, -45, 37, 1, -1, 0)
    assert KrlConfiguration(flags("6", "18"), ("S", "T")).agrees(readings, margin=0.0)
    for wrong in (("6", "50"), ("6", "19"), ("2", "18"), ("4", "18"), ("7", "18")):
        assert not KrlConfiguration(flags(*wrong), ("S", "T")).agrees(readings, margin=0.0)


# S and T of points taught at robots, as they stand in thirteen programs that people have published
TAUGHT = (
    (2, 35),
    (2, 2),
    (2, 10),
    (2, 34),
    (22, 18),
    (22, 27),
    (22, 50),
    (18, 10),
    (18, 34),
    (18, 2),
    (6, 26),
    (6, 27),
    (6, 50),
)


@pytest.mark.parametrize(("status", "turn"), TAUGHT)
def test_points_taught_at_robots_are_of_one_posture(status, turn):
    """Fails if S and T that a controller wrote together contradict each other by what is made of them: A5 and A3 stand in both."""
    signs = [-1 if turn >> k & 1 else 1 for k in range(6)]
    assert signs[2] > 0  # the elbow bent as usual
    stands = posture(*(30 * sign for sign in signs), front=True, elbow=True)
    found = KrlConfiguration(flags(str(status), str(turn)), ("S", "T"))
    assert found.agrees(stands)
    stretched = posture(*(30 * sign for sign in signs), front=True, elbow=False)
    assert not found.agrees(stretched)


def test_quarters_of_a_turn_as_the_manual_has_them():
    """Fails if ABB's quadrant 0 is not the first quarter in the positive direction, or -1 not the one before it (confdata)."""
    for degrees, quarter in ((1, 0), (89, 0), (91, 1), (181, 2), (271, 3), (-1, -1), (-89, -1), (-91, -2), (-181, -3)):
        assert RapidConfiguration(()).of(posture(degrees, 0, 0, degrees, 30, degrees))[:3] == (str(quarter),) * 3


def test_only_what_crosses_a_boundary_changes():
    """Fails if a flag that stays is written anew, or one that must change is kept."""
    before, after = posture(0.01, -90, 90, 10, 15, -5), posture(-0.01, -90, 90, 10, 15, -5)
    bits = KrlConfiguration(flags("18", "34"), ("S", "T"))  # bit 4 of S: taught with an absolutely accurate robot
    assert bits.changes(before, after) == ((bits.flags[1], "35"),)
    spelled = KrlConfiguration(flags("'B100010'"), ("T",))
    assert spelled.changes(before, after) == ((spelled.flags[0], "'B100011'"),)
    quarters = RapidConfiguration(flags("0", "0", "-1", "0"))
    assert quarters.changes(before, after) == ((quarters.flags[0], "-1"),)
    wrist = FanucConfiguration(flags("F", "U", "T", "0", "0", "0"))
    assert wrist.changes(posture(0, 0, 0, 0, 0.01, 0), posture(0, 0, 0, 0, -0.01, 0)) == ((wrist.flags[0], "N"),)


def test_a_flag_at_a_boundary_is_that_of_the_corrected_posture():
    """Fails if a joint at a boundary, which the file counts to one side and the solution to the other, ends on the wrong one."""
    before, after = posture(-1e-9, -90, 90, 10, 15, 89.9999999), posture(0.01, -90, 90, 10, 15, 90.01)
    told = KrlConfiguration(flags("2", "2"), ("S", "T"))  # bit 0 of T is not set: A1 counts as 0 and more
    assert told.agrees(before)
    assert told.changes(before, after) == ()
    quarters = RapidConfiguration(flags("0", "0", "1", "0"))
    assert quarters.agrees(before)
    assert quarters.changes(before, after) == ()


def test_a_flag_taught_on_a_boundary_goes_where_its_joint_goes():
    """Fails if axis 4 of a target, taught at 0 and found a rounding below, is sent below 0 with the flag of 0 and more."""
    before, after = posture(10, -90, 90, -1e-9, 15, 1e-9), posture(10, -90, 90, -0.08, 15, -0.05)
    quarters = RapidConfiguration(flags("0", "0", "0", "0"))
    assert quarters.changes(before, after) == ((quarters.flags[1], "-1"), (quarters.flags[2], "-1"))
    assert quarters.changes(before, posture(11, -90, 90, -1e-9, 15, -1e-9)) == ((quarters.flags[2], "-1"),)
    bits = KrlConfiguration(flags("2", "2"), ("S", "T"))
    assert bits.changes(before, after) == ((bits.flags[1], "42"),)
    coarse = posture(10, -90, 90, -0.004, 15, 10)  # of a pose with few digits, near a singular one
    assert quarters.changes(coarse, posture(10, -90, 90, -0.1, 15, 10)) == ((quarters.flags[1], "-1"),)
    assert quarters.changes(coarse, posture(10, -90, 90, -0.001, 15, 10)) == ()
    turns = FanucConfiguration(flags("N", "U", "T", "0", "0", "0"))
    below, beyond = posture(0, 0, 0, 180 + 1e-9, -30, 0), posture(0, 0, 0, 180.1, -30, 0)
    assert turns.changes(below, beyond) == ((turns.flags[4], "1"),)


def test_a_flag_that_some_robots_do_not_use_is_not_asked_for_twice():
    """Fails if a cfx that is always 0 makes a target's posture unknown."""
    unused = RapidConfiguration(flags("0", "0", "0", "0"))
    negative = posture(1, 2, 3, 4, -5, 6)
    assert not unused.agrees(negative)
    assert unused.agrees(negative, strictly=False)
