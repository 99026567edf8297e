"""A motor's turn is found wherever it begins and ends, and the wrong block is not taken for the right one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.faults import examined
from calflow.faults.encoder_turn import turned_block
from calflow.faults.reference import Reference
from calflow.faults.setup import Setup
from calflow.measurements.measurements import Measurements
from calflow.robot.parts import Base
from calflow.study import load_study
from hidden.case import Case, write_case


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A robot of 60 poses with gear ratios near 200, whose base nobody knows."""
    folder = tmp_path_factory.mktemp("turns")
    case = Case(poses=60, payloads=("none",), effects=("geometry",), workflow="paper-table")
    write_case(folder, case, np.random.default_rng(41))
    data = load_study(folder).measurements()
    return data.on(replace(data.robot, base=Base(known=False)))


def turned(data, joint, begin, end, sense=1):
    """The data with a turn of a joint's motor in rows from begin to end."""
    table = data.table.copy()
    table.loc[begin : end - 1, f"q{joint}"] += sense * 2 * np.pi / data.robot.joints[joint - 1].gear_ratio
    return Measurements(data.robot, table, data.notes)


@pytest.mark.parametrize(
    ("joint", "begin", "end", "sense"),
    [(2, 20, 60, 1), (5, 0, 31, -1), (3, 15, 46, 1)],
    ids=["most rows, to the end", "half of the rows, from the start", "half of the rows, in the middle"],
)
def test_the_block_is_the_one_that_spoils_the_zero(measured, joint, begin, end, sense):
    """Fails if a block near half of the rows is missed, or the others are turned, so that the joint's zero is a turn off."""
    data = turned(measured, joint, begin, end, sense)
    after, found = examined(data)
    assert [(fault.cause, fault.joint) for fault in found] == [("encoder-turn", joint)]
    assert found[0].lines == tuple(data.table["line"][begin:end])
    np.testing.assert_allclose(after.joints, measured.joints, atol=1e-9)


def test_a_zero_that_changed_by_nearly_a_turn_is_none(measured):
    """Fails if a wrist's zero set anew by nine tenths of a turn is taken for a turn, which leaves a tenth of it in all rows."""
    data, turn = measured.table.copy(), 2 * np.pi / measured.robot.joints[4].gear_ratio
    data.loc[25:, "q5"] += 0.9 * turn
    (found,) = examined(Measurements(measured.robot, data, measured.notes))[1]
    assert (found.cause, found.joint) == ("zero-changed", 5)


def test_where_the_base_makes_up_for_the_zero_it_is_the_smaller_block(measured):
    """Fails if joint 1, whose zero a base that nobody knows hides, is turned in the larger part."""
    (found,) = examined(turned(measured, 1, 40, 60))[1]
    assert (found.cause, found.joint, len(found.lines)) == ("encoder-turn", 1, 20)


def test_good_rows_gain_nothing_from_a_turn(measured):
    """Fails if the scan's sums are wrong: a turn that is not there gains, or one that is does not."""
    step = 2 * np.pi / measured.robot.joints[1].gear_ratio
    for data, there in ((measured, False), (turned(measured, 2, 20, 45), True)):
        gain, block = turned_block(data, Reference.of(data, Setup.of(data)).fit, 1, step)
        assert gain > 100 if there else gain == 0
    sides = {tuple(np.flatnonzero(one.rows)[[0, -1]] + 1): one.step for one in (block, block.complement)}
    assert any(first in (20, 21, 22) and last in (44, 45, 46) and value < 0 for (first, last), value in sides.items())


def test_a_long_block_does_not_hide_a_wrong_sign(measured):
    """Fails if a sign in the robot file is not found beside a turn in a third of the rows, and another figure is blamed."""
    joint, turns = 4, 2
    data = turned(measured, turns, 40, 60)
    data = replace(data, table=data.table.assign(**{f"q{joint}": -data.table[f"q{joint}"]}))
    after, found = examined(data)
    assert [(fault.cause, fault.joint) for fault in found] == [("joint-sign", joint), ("encoder-turn", turns)]
    np.testing.assert_allclose(after.joints, measured.joints, atol=1e-9)
