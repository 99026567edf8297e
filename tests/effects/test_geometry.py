"""Geometry: which figures it corrects, and that each moves the robot as a wrong figure would."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import robots
from calflow.effects.geometry import Geometry
from calflow.model import Model, build
from calflow.robot.mechanism import Row, nominal_dimensions
from calflow.robot.parts import Base
from calflow.robot.robot import Robot

TWO_MARKERS = {"A": {"point_m": [0.05, -0.03, 0.12]}, "B": {"point_m": [-0.1, 0.0, 0.2]}}
ROBOTS = {
    "hh800": robots.hh800(base=robots.ASKEW),
    "hh800 other bars": robots.hh800_with_bars(0.75, 1.7, 0.9),
    "ur10": replace(robots.ur10(markers=TWO_MARKERS, tool_rotation_deg=[10, -20, 30]), base=robots.ASKEW),
    "industrial": robots.industrial(),
}
CASES = [(name, parameter.name) for name, robot in ROBOTS.items() for parameter in Geometry(robot).parameters()]


def names(robot: Robot) -> list[str]:
    """Names of the geometry's parameters."""
    return [parameter.name for parameter in Geometry(robot).parameters()]


def expected(text: str) -> list[str]:
    """Spell out `joint2: alpha a; ...`."""
    parts = (part.split(":") for part in text.split(";"))
    return [f"{part.strip()}.{symbol}" for part, symbols in parts for symbol in symbols.split()]


def perturbed(robot: Robot, name: str, by: float) -> dict[str, np.ndarray]:
    """All figures of a robot's file with the named one wrong by some amount."""
    figs = robots.figures(robot)
    part, symbol = name.split(".")
    xyz = ["x", "y", "z", "rx", "ry", "rz"]
    if part == "base":
        figs["base"][xyz.index(symbol)] += by
    elif part == "loop":
        figs["bars"][["crank", "rod", "rocker"].index(symbol)] += by
    elif part == "tool":
        figs["tool"][xyz.index(symbol) - 3] += by
    elif part.startswith("joint"):
        figs[symbol][int(part[5:]) - 1] += by
    else:
        figs["markers"][xyz.index(symbol), list(robot.markers).index(part)] += by
    return figs


def test_hh800_has_the_papers_31_parameters() -> None:
    """Breaks if a figure is forgotten, two that move the tool alike are both kept, or their order changes."""
    assert names(robots.hh800()) == expected(
        "base: x y z rx ry rz; joint2: alpha a d theta; joint3: alpha a beta theta; joint4: alpha a d theta;"
        "joint5: alpha a d theta; joint6: alpha a d theta; loop: crank rod; E: x y z"
    )
    assert len(names(robots.hh800())) == 31


def test_ur10_in_dh_has_29_parameters() -> None:
    """Breaks if DH's parallel axes 2, 3 and 4 keep an undefined d, or base or tool figures come twice."""
    assert names(robots.ur10()) == expected(
        "base: x y z rx ry rz; joint1: a alpha; joint2: theta beta a alpha; joint3: theta beta a alpha;"
        "joint4: theta d a alpha; joint5: theta d a alpha; joint6: theta d; E: x y z"
    )


def test_parallel_first_axes_in_dh() -> None:
    """Breaks if a first joint, whose own place is the base's, loses the error of its parallel neighbour's direction."""
    planar = robots.robot("dh", [{"a_m": 0.4}, {"a_m": 0.3}, {"a_m": 0.2}])
    assert names(planar)[6:-3] == expected("joint1: beta a alpha; joint2: theta beta a alpha; joint3: theta d")


def test_markers_and_a_stated_tool_rotation_add_theirs() -> None:
    """Breaks if a second marker has no parameters of its own, or an unstated orientation is corrected."""
    assert names(ROBOTS["ur10"])[26:] == expected("A: x y z; B: x y z; tool: rx ry rz")


def test_markers_whose_places_beside_the_first_are_known_move_and_turn_with_it() -> None:
    """Breaks if a known distance between markers changes with the tool, or a marker's own small error is lost."""
    known = {name: dict(marker) for name, marker in TWO_MARKERS.items()}
    known["B"]["relative_sd_mm"] = 0.01
    robot = robots.ur10(markers=known)
    assert names(robot)[-9:] == expected("A: x y z; B: x y z; markers: rx ry rz")
    geometry = Geometry(robot)
    sds = [parameter.prior_sd for parameter in geometry.parameters()[-9:]]
    assert_allclose(sds, [0.02] * 3 + [1e-5] * 3 + [0.02] * 3)
    p = np.zeros(len(geometry.parameters()))
    p[-9:] = 2e-3, -1e-3, 3e-3, 0, 0, 1e-5, 0.02, -0.01, 0.03
    first, second = np.array(
        ca.DM(ca.evalf(geometry.dimensions(ca.SX(p), nominal_dimensions(robot), Row.symbols(robot)).markers))
    ).T
    stated = [np.array(marker["point_m"]) for marker in TWO_MARKERS.values()]
    assert_allclose(first, stated[0] + p[-9:-6])
    turn = Rotation.from_euler("XYZ", p[-3:])
    assert_allclose(second - first, turn.apply(stated[1] - stated[0]) + p[-6:-3], atol=1e-12)


@pytest.mark.parametrize("name", ["hh800", "hh800 other bars", "industrial"])
def test_only_the_last_joint_trades_against_the_marker(name: str) -> None:
    """Breaks if two parameters move the marker alike in every pose, or one does not move it at all.

    What remains is the last joint's theta and d against the marker's own coordinates.
    """
    model = build(ROBOTS[name], ["geometry"])
    conditions = robots.rows(model, robots.poses(model.robot, 80))
    singular = np.linalg.svd(model.position_jacobian(model.nominal, conditions).reshape(240, -1), compute_uv=False)
    n = len(model.parameters)
    assert singular[n - 3] > 1e-6 * singular[0]
    assert (singular[n - 2 :] < 1e-12 * singular[0]).all()


def test_priors_and_bounds() -> None:
    """Breaks if a link's figure may err like a marker's place, or an unknown base is held as a known one."""
    parameters = {parameter.name: parameter for parameter in Geometry(robots.hh800()).parameters()}
    link, marker, base = (parameters[name] for name in ("joint2.a", "E.x", "base.x"))
    assert link.prior_sd < marker.prior_sd == base.prior_sd
    assert link.unit == base.unit == "m"
    assert parameters["joint3.beta"].unit == parameters["base.rz"].unit == "rad"
    unknown = Geometry(robots.hh800(base=Base(known=False))).parameters()
    assert all(parameter.prior_sd > 10 * base.prior_sd for parameter in unknown[:6])
    assert unknown[6:] == Geometry(robots.hh800()).parameters()[6:]
    for parameter in (*parameters.values(), *unknown):
        assert parameter.lower < -3 * parameter.prior_sd < 0 < 3 * parameter.prior_sd < parameter.upper


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_each_parameter_names_the_figure_it_is_added_to(robot: Robot) -> None:
    """Breaks if a table's sum of figure and error starts from another figure, or in another unit."""
    stated = robots.figures(robot)
    for parameter in Geometry(robot).parameters():
        wrong = perturbed(robot, parameter.name, 1.0)
        (figure,) = [
            stated[kind][wrong[kind] != stated[kind]] for kind in stated if (wrong[kind] != stated[kind]).any()
        ]
        assert_allclose(parameter.figure, figure)


@pytest.mark.parametrize("name", ROBOTS)
def test_zero_errors_change_nothing(name: str) -> None:
    """Breaks if the effect shifts anything by itself: the model without it, to the last bit."""
    robot = ROBOTS[name]
    with_it, without = build(robot, ["geometry"]), Model(robot, ())
    conditions = robots.rows(without, robots.poses(robot, 20), marker=next(iter(robot.markers)))
    p = np.zeros(len(with_it.parameters))
    assert (with_it.position(p, conditions) == without.position(np.zeros(0), conditions)).all()
    assert (with_it.rotation(p, conditions) == without.rotation(np.zeros(0), conditions)).all()


@pytest.fixture(scope="module")
def models() -> dict[str, Model]:
    """One model for each robot, so that its functions are built once."""
    return {name: build(robot, ["geometry"]) for name, robot in ROBOTS.items()}


@pytest.mark.parametrize(("name", "parameter"), CASES)
def test_each_error_is_a_wrong_figure(models: dict[str, Model], name: str, parameter: str) -> None:
    """Breaks if an error changes another figure than its name says, or with another sign."""
    model, robot, error = models[name], ROBOTS[name], 0.013
    figs = perturbed(robot, parameter, error)
    p = error * np.array([other.name == parameter for other in model.parameters])
    q = robots.poses(robot, 6)
    moved = 0.0
    for k, marker in enumerate(robot.markers):
        conditions = robots.rows(model, q, marker=marker)
        position = model.position(p, conditions)
        assert_allclose(position, robots.marker_position(robot, q, figs, k), atol=1e-12)
        moved = max(moved, np.abs(position - robots.marker_position(robot, q, marker=k)).max())
        assert_allclose(model.rotation(p, conditions), robots.tool_rotation(robot, q, figs), atol=1e-12)
    assert (moved > 1e-4) == (not parameter.startswith("tool."))  # a tool's rotation turns it about the flange


def test_all_errors_act_together(models: dict[str, Model]) -> None:
    """Breaks if one error overwrites another of the same kind."""
    for name, robot in ROBOTS.items():
        model = models[name]
        p = np.random.default_rng(5).normal(scale=5e-3, size=len(model.parameters))
        nominal, figs = robots.figures(robot), robots.figures(robot)
        for parameter, value in zip(model.parameters, p, strict=True):
            for kind, wrong in perturbed(robot, parameter.name, value).items():
                figs[kind] = figs[kind] + wrong - nominal[kind]
        q = robots.poses(robot, 10)
        conditions = robots.rows(model, q, marker=next(iter(robot.markers)))
        assert_allclose(model.position(p, conditions), robots.marker_position(robot, q, figs), atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_derivatives_equal_central_differences(models: dict[str, Model], name: str) -> None:
    """Breaks if a Jacobian's column is not that parameter's derivative, or rows and columns are swapped."""
    model, step = models[name], 3e-6
    p = np.random.default_rng(6).normal(scale=2e-3, size=len(model.parameters))
    conditions = robots.rows(model, robots.poses(model.robot, 5), marker=next(iter(model.robot.markers)))
    jacobian = model.position_jacobian(p, conditions)
    assert jacobian.shape == (5, 3, len(p))
    for k, unit in enumerate(np.eye(len(p))):
        wanted = (model.position(p + step * unit, conditions) - model.position(p - step * unit, conditions)) / (
            2 * step
        )
        assert_allclose(jacobian[:, :, k], wanted, atol=1e-6 * max(np.abs(wanted).max(), 1e-3))
