"""The sag of a tool or of one marker's mount under a weight that nobody knows."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow.effects.tool_deflection import ToolDeflection
from calflow.effects.tool_sag import ToolSag
from calflow.model import Model
from calflow.robot.parts import Payload
from robots import industrial, poses, rows, tool_rotation

POINTS = {"E": {"point_m": [0.05, -0.03, 0.12]}, "F": {"point_m": [0.3, 0.1, 0.4]}, "tool": {"point_m": [0, 0, 0.2]}}


def shifts(shape: str, values: dict[str, float], marker: str) -> tuple[np.ndarray, np.ndarray]:
    """By how much some parameters move a marker in the flange's axes (rows, 3), and gravity's direction there."""
    robot = industrial(markers=POINTS)
    effect = ToolSag(robot, shape)
    q = poses(robot, 12)
    model = Model(robot, (effect,))
    names = [f"{parameter.part}.{parameter.symbol}" for parameter in effect.declared]
    p = np.zeros(len(names))
    for name, value in values.items():
        p[names.index(name)] = value
    packed = rows(model, q, "load", marker)
    moved = model.position(p, packed) - model.position(0 * p, packed)
    turn = tool_rotation(robot, q)
    return np.einsum("nji,nj->ni", turn, moved), -turn[:, 2]


@pytest.mark.parametrize("shape", ["cantilever", "symmetric", "any"])
def test_a_markers_mount_moves_that_marker_alone(shape):
    """Fails if another marker moves, the marker moves along another axis, or one called `tool` is taken for the whole."""
    symbol = "c" if shape == "cantilever" else "cx"
    along = np.array([1.0, 1.0, 0.0]) if shape == "cantilever" else np.array([1.0, 0.0, 0.0])
    for part, marker in (("F", "F"), ("tool (marker)", "tool")):
        own, down = shifts(shape, {f"{part}.{symbol}": 1e-4}, marker)
        assert_allclose(own, 1e-4 * along * down, atol=1e-9)
        other, _ = shifts(shape, {f"{part}.{symbol}": 1e-4}, "E")
        assert not other.any()


def test_a_bracket_turns_what_is_on_it():
    """Fails if a marker farther out or off the axis does not move as a body that turns about the flange does."""
    for marker, place in POINTS.items():
        own, down = shifts("cantilever", {"tool.t": 3e-4}, marker)
        turn = 3e-4 * np.cross([0.0, 0.0, 1.0], down)
        assert_allclose(own, np.cross(turn, place["point_m"]), atol=2e-7)


def test_a_loose_tool_lies_on_its_lower_side_however_little_that_is_lower():
    """Fails if a tool that lies in its holder's clearance moves in proportion to its tilt, as one that bends does."""
    own, down = shifts("loose", {"tool.c": 1e-4, "tool.t": 3e-4}, "E")
    across = down * [1.0, 1.0, 0.0]
    lower = across / np.linalg.norm(across, axis=1, keepdims=True)
    clear = np.linalg.norm(across, axis=1) > 0.3
    assert clear.sum() > 0
    turned = np.cross(3e-4 * np.cross([0.0, 0.0, 1.0], lower), POINTS["E"]["point_m"])
    assert_allclose(own[clear], (1e-4 * lower + turned)[clear], rtol=0.01, atol=1e-6)


@pytest.mark.parametrize("effect", [ToolSag, ToolDeflection])
def test_a_bracket_that_turns_alone_has_a_size(effect):
    """Fails if the size reported of a tool that rotates about the flange is a shift of the flange, which is none."""
    robot = industrial(markers=POINTS)
    bracket = effect(robot, {ToolSag: "cantilever", ToolDeflection: "bracket"}[effect])
    farthest = np.linalg.norm(POINTS["F"]["point_m"])
    assert_allclose(float(ca.evalf(bracket.size(ca.SX([0.0, 2e-4]), bracket.declared))), 2e-4 * farthest)


def test_an_adapter_may_tilt_as_far_on_a_small_arm():
    """Fails if an adapter is as stiff a priori on an arm for 5 kg as on one for 500, or a payload on the flange tilts one."""
    robot = industrial()
    small, large, none = (
        ToolDeflection(replace(robot, payloads={"load": Payload(mass, (0.0, 0.0, lever))}), "adapter").declared
        for mass, lever in ((5.0, 0.2), (500.0, 0.2), (50.0, 0.0))
    )
    assert_allclose(small[0].upper, 100 * large[0].upper)
    assert not none


def test_any_matrix_moves_one_axis_across_another():
    """Fails if an entry of the matrix stands for its mirror."""
    own, down = shifts("any", {"tool.cyx": 1e-4}, "E")
    assert_allclose(own, 1e-4 * np.outer(down[:, 0], [0, 1, 0]), atol=1e-9)
    own, down = shifts("symmetric", {"tool.cxy": 1e-4}, "E")
    assert_allclose(own, 1e-4 * np.column_stack([down[:, 1], down[:, 0], 0 * down[:, 0]]), atol=1e-9)


def test_one_marker_has_no_sag_of_its_own():
    """Fails if a tool with one marker has two names for one sag."""
    assert {parameter.part for parameter in ToolSag(industrial()).declared} == {"tool"}
