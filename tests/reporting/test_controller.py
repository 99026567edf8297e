"""The figures for the controller: typed in as they stand, they make the calibrated robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calflow.files.words import mm
from calflow.reporting.blocks import Table
from calflow.reporting.material import Material
from calflow.reporting.sections.controller_figures import controller_section, reported_figures, zeros
from calflow.reporting.sections.verdict import levels_of_effort
from calflow.stages.report import report_material
from reporting.case import Case, context

AXES = {"alpha": "x", "beta": "y", "theta": "z"}


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    given = context(tmp_path_factory.mktemp("stiff"), Case(payload=False))
    return report_material(given.study, given.results, given.run_folder)


def moved(rotation: Rotation, shift: np.ndarray) -> np.ndarray:
    """A homogeneous transform that turns, after it has shifted."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation.as_matrix(), shift
    return made


def test_the_figures_make_the_calibrated_robot(material: Material) -> None:
    """Fails if a figure has the wrong sign or unit, is not the calibrated one, or the base is composed in another order."""
    parts = {
        part: {name: figure.calibrated for name, figure in of.items()}
        for part, of in reported_figures(material).items()
    }
    stands, (marker,) = parts["base"], material.calibrated.model.robot.markers
    turn = Rotation.from_euler("XYZ", [stands[name] for name in ("rx", "ry", "rz")], degrees=True)
    for k in range(5):
        chain = moved(turn, np.array([stands[axis] for axis in "xyz"]) / 1e3)
        for i, reading in enumerate(material.data.joints[k], start=1):
            own = parts[f"joint {i}"]
            chain = chain @ moved(Rotation.identity(), np.array([own["a"] / 1e3, 0, 0]))
            for symbol in ("alpha", "beta", "theta"):
                turned = np.deg2rad(own[symbol]) + (reading if symbol == "theta" else 0.0)
                chain = chain @ moved(Rotation.from_euler(AXES[symbol], turned), np.zeros(3))
            chain = chain @ moved(Rotation.identity(), np.array([0, 0, own["d"] / 1e3]))
        seen = material.calibrated.model.point(material.calibrated.estimate, material.data.conditions)[k]
        place = [parts[f"marker {marker}"][axis] / 1e3 for axis in "xyz"]
        np.testing.assert_allclose((chain @ [*place, 1.0])[:3], seen, atol=1e-9)


def test_zeros_are_those_of_the_makers_lengths_and_twists(material: Material) -> None:
    """Fails if a zero is cut out of a fit of all figures, or is not what a reading is to be moved by."""
    robot, fit = material.calibrated.model.robot, material.levels.alone["zeros and tool"]
    joints = [one for one in fit.model.parameters if one.joint]
    assert {one.symbol for one in joints} == {"theta"}
    own = {one.joint: value for one, value in zip(fit.model.parameters, fit.estimate, strict=True) if one.joint}
    off = [np.rad2deg(own.get(i, 0.0)) for i in range(1, robot.n_joints + 1)]
    np.testing.assert_allclose(robot.reading_matrix @ zeros(robot, material.levels), off, atol=1e-9)


def test_without_anything_else_in_the_model_the_figures_are_worth_as_much(material: Material) -> None:
    """Fails if what the figures alone are worth is not the model's own accuracy where it has nothing besides."""
    found, judged = material.levels.by("figures"), material.distance[material.held]
    assert (found.mean, found.max) == pytest.approx((judged.mean(), judged.max()), rel=0.02)


def test_the_page_holds_every_figure(material: Material) -> None:
    """Fails if a joint or the base is missing, or the section is there without a fitted geometry."""
    tables = [block for block in controller_section.write(material) if isinstance(block, Table)]
    assert [len(table.rows) for table in tables] == [3, 3, 1, 1, 2]
    assert tables[0].header[0] == "joint"
    levels, _ = levels_of_effort(material)
    assert [row[1:] for row in levels.rows] == [[mm(level.mean), mm(level.max)] for level in material.levels.every]
    assert controller_section.has_content(material)


def test_a_tool_differs_from_the_robot_file(material: Material) -> None:
    """Fails if a tool that the training poses placed anew is told beside where they placed it, not beside the robot file."""
    (marker,) = material.robot.markers
    point, stated = reported_figures(material)[f"marker {marker}"], material.robot.markers[marker]
    elsewhere = replace(stated, point=(stated.point[0] - 0.25, *stated.point[1:]))
    robot = replace(material.robot, markers={marker: elsewhere})
    moved = reported_figures(replace(material, robot=robot))[f"marker {marker}"]
    assert [moved[axis].calibrated for axis in "xyz"] == pytest.approx([point[axis].calibrated for axis in "xyz"])
    assert moved["x"].difference - point["x"].difference == pytest.approx(250.0, abs=1.0)
    assert moved["x"].nominal == pytest.approx(1e3 * elsewhere.point[0])
