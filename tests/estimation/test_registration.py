"""A robot that stands anywhere is found from the training poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import calflow as cf
import robots
from calflow.design.candidates import packed_conditions
from calflow.estimation.accuracy import distances, leading_errors
from calflow.estimation.registration import base_turn, registered, registered_model
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.observations import observations
from calflow.robot.parts import Base, Marker
from estimation.data import measured
from first_steps import FIRST_STEPS
from robots import industrial


@pytest.mark.parametrize("angles", [(170, 20, -100), (0, 90, 45), (-120, -60, 10)])
def test_base_and_tool_are_found(angles):
    """Fails for a tracker that stands on its head, beside a singular angle, or far away."""
    rng = np.random.default_rng(18)
    robot = industrial()
    stands = Base(origin=(12.0, -7.0, 2.0), rotation=np.deg2rad(angles))
    name = next(iter(robot.markers))
    moved = Marker(point=tuple(np.add(robot.markers[name].point, (0.02, -0.03, 0.05))))
    real = build(replace(robot, base=stands, markers={name: moved}), ())
    data = measured(real, real.nominal, 40, rng)
    found, _ = registered(replace(robot, base=Base(known=False)), observations(data), data)
    np.testing.assert_allclose(found.base.origin, stands.origin, atol=1e-4)
    turn = Rotation.from_euler("XYZ", found.base.rotation).inv() * Rotation.from_euler("XYZ", stands.rotation)
    assert turn.magnitude() < 1e-4
    np.testing.assert_allclose(found.markers[name].point, moved.point, atol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_full_poses_place_a_target_of_which_nobody_knows_anything(seed):
    """Fails if a positioner of two axes is found in its mirror image, where positions alone tell it from nothing."""
    rng = np.random.default_rng(seed)
    joints = (cf.Joint(cf.dh(alpha=-np.pi / 2)), cf.Joint(cf.dh(d=-0.475, theta=-np.pi / 2)))
    stated = cf.Robot(joints=joints, markers={"target": Marker((0.0, 0.0, 0.0), known=False)}, tool_rotation=(0.0, 0.0, 0.0),
                      base=Base(known=False))  # fmt: skip
    turns = Rotation.random(2, random_state=rng)
    real = replace(
        stated,
        base=Base(origin=tuple(rng.normal(size=3)), rotation=tuple(turns[0].as_euler("XYZ"))),
        markers={"target": Marker(tuple(rng.normal(size=3)))},
        tool_rotation=tuple(turns[1].as_euler("XYZ")),
    )
    model = build(real, ())
    readings = rng.uniform((-0.5, 0.0), (0.5, 6.0), (40, 2))
    conditions = packed_conditions(model, readings, "", "target")
    position = model.position(model.nominal, conditions) + 1e-4 * rng.normal(size=(40, 3))
    noise = Rotation.from_rotvec(1e-3 * rng.normal(size=(40, 3)))
    rotation = (Rotation.from_matrix(model.rotation(model.nominal, conditions)) * noise).as_matrix()
    data = Measurements.from_arrays(stated, readings, position, rotation=rotation, sigma=1e-4, sigma_rotation=1e-3)
    found, _ = registered(stated, observations(data), data)
    placed = build(found, ()).position(np.zeros(0), conditions)
    assert np.linalg.norm(placed - position, axis=1).mean() < 3e-4


def test_what_is_stated_of_a_marker_is_about_its_place_in_the_robot_file(tmp_path):
    """Fails if it is about the place with which the nominal robot fits best: the last link would be too short."""
    robot = replace(robot_with_two_markers(), base=Base(known=False))
    stated = [
        cf.Expected(name=f"{part}.{axis}", unit=unit, mean=0.0, sd=sd)
        for part, axes, unit, sd in (("E", "xyz", "m", 2e-5), ("markers", ("rx", "ry", "rz"), "rad", 1e-4))
        for axis in axes
    ]
    figures = robots.figures(robot)
    figures["d"][5] += 1e-3
    figures["theta"][5] += 2e-3
    q = robots.poses(robot, 50)
    seen = [robots.marker_position(robot, q, figures, marker) for marker in range(2)]
    noise = 2e-5 * np.random.default_rng(4).standard_normal((100, 3))
    data = Measurements.from_arrays(
        robot, np.vstack([q, q]), np.vstack(seen) + noise, marker=["E"] * 50 + ["F"] * 50, pose=np.tile(np.arange(50), 2),
        sigma=2e-5,
    ).split(0.2, 1)  # fmt: skip
    told = cf.identify(replace(robot, expected=tuple(stated)), data, effects=["geometry"])
    for found in (told, cf.Calibration.load(told.save(tmp_path / "run"))):
        assert found.parameters["joint6.d"].value == pytest.approx(1e-3, abs=6e-5)
        assert found.parameters["joint6.theta"].value == pytest.approx(2e-3, abs=3e-4)
        assert found.model.prior_mean == pytest.approx(told.model.prior_mean, abs=1e-12)


def robot_with_two_markers():
    """An arm with masses of which nobody needs any, and two reflectors well apart on its flange."""
    return industrial(
        markers={"E": {"point_m": [0.12, 0, 0.1]}, "F": {"point_m": [-0.1, 0.08, 0.15], "relative_sd_mm": 0.02}}
    )


def test_turns_about_one_line_do_not_tell_how_the_base_is_turned():
    """Fails if orientations that leave a turn open are taken for an answer."""
    about_z = Rotation.from_euler("z", np.linspace(-2, 2, 9)[:, None]).as_matrix()
    assert base_turn(about_z, about_z) is None
    assert base_turn(about_z, None) is None


@pytest.mark.parametrize("known", [True, False])
def test_markers_that_nobody_knows_are_found_far_from_the_flange(known):
    """Fails if a marker 0.9 m from where the robot file has it is lost, one known beside it stays, or an outlier moves it."""
    rng = np.random.default_rng(21)
    stands = Base(origin=(3.0, -1.0, 0.5), rotation=np.deg2rad((10, -20, 130)))
    places = {"A": (0.05, 0.0, 0.1), "B": (0.0, 0.02, 0.1), "C": (0.5, 0.6, 0.5)}
    beside = {"D": (0.1, -0.1, 0.2)}
    real = replace(
        industrial(), base=stands, markers={name: Marker(point) for name, point in (places | beside).items()}
    )
    parts = [measured(build(one, ()), build(one, ()).nominal, 15, rng) for one in
             (replace(real, markers={name: marker, **real.markers}) for name, marker in real.markers.items())]  # fmt: skip
    table = pd.concat([part.table for part in parts], ignore_index=True)
    table.loc[3, "x"] += 0.5
    stated = {"A": Marker((0.05, 0.001, 0.1)), "B": Marker((0, 0.02, 0.1)), "C": Marker((0, 0, 0), known=False)}
    file = replace(real, base=replace(stands, known=known), markers=stated | {"D": Marker(beside["D"])})
    found, _ = registered(file, observations(parts[0]), Measurements(file, table))
    assert np.linalg.norm(found.markers["C"].point) > 0.9
    np.testing.assert_allclose(found.markers["C"].point, places["C"], atol=1e-3)
    if known:
        assert found.base == file.base
        assert found.markers["A"] == file.markers["A"]


def test_markers_beside_an_unknown_first_one_go_with_it():
    """Fails if the distances of markers that were measured apart are lost with the place of the first."""
    rng = np.random.default_rng(22)
    robot = industrial()
    first, second = (0.7, 0.2, 0.5), (0.7, 0.2, 0.8)
    real = replace(robot, markers={"A": Marker(first), "B": Marker(second)})
    data = measured(build(real, ()), build(real, ()).nominal, 40, rng)
    stated = replace(real, markers={"A": Marker((0, 0, 0), known=False), "B": Marker((0, 0, 0.3), relative_sd=1e-5)})
    found, _ = registered(stated, observations(data), data.on(stated))
    np.testing.assert_allclose([found.markers["A"].point, found.markers["B"].point], [first, second], atol=1e-3)


def test_a_known_base_stays():
    """Fails if a base that the robot file states is moved."""
    robot = industrial()
    data = measured(build(robot, ()), build(robot, ()).nominal, 10, np.random.default_rng(19))
    assert registered(robot, observations(data), data)[0] is robot


@pytest.mark.parametrize("study", ["sockets", "wire"])
def test_an_unknown_tool_is_placed_without_positions_too(study: str) -> None:
    """Fails if a nominal robot is judged with the rough place of a ball that sockets or a wire show where it is."""
    data = cf.load_study(FIRST_STEPS / f"{study}.toml").measurements()
    rough = replace(data.robot.markers["ball"], point=(0.0, 0.0, 0.1), known=False)
    model, here = registered_model(data.on(replace(data.robot, markers={"ball": rough})))
    np.testing.assert_allclose(here.robot.markers["ball"].point, data.robot.markers["ball"].point, atol=3e-3)
    assert np.median(distances(leading_errors(model, model.nominal, here))) < 1e-3
