"""Configuration: flags tell postures as the makers' manuals do, and change only where a correction crosses a boundary."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.deployment.programs.configuration import (
    FanucConfiguration,
    Flag,
    KrlConfiguration,
    Posture,
    RapidConfiguration,
)


def posture(*degrees, front=True, elbow=True):
    return Posture(tuple(np.deg2rad(degrees)), front, elbow)


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


def test_only_what_crosses_a_boundary_changes():
    """Fails if a flag that stays is written anew, or one that must change is kept."""
    before, after = posture(0.01, -90, 90, 10, 15, -5), posture(-0.01, -90, 90, 10, 15, -5)
    bits = KrlConfiguration(flags("18", "34"), ("S", "T"))  # bit 4 of S: taught with an absolutely accurate robot
    assert bits.changes(before, after) == ((bits.flags[1], "35"),)
    spelled = KrlConfiguration(
        flags(
            "'B100010'",
        ),
        ("T",),
    )
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


def test_a_flag_that_some_robots_do_not_use_is_not_asked_for_twice():
    """Fails if a cfx that is always 0 makes a target's posture unknown."""
    unused = RapidConfiguration(flags("0", "0", "0", "0"))
    negative = posture(1, 2, 3, 4, -5, 6)
    assert not unused.agrees(negative)
    assert unused.agrees(negative, strictly=False)
