"""What is said of a prismatic joint is in metres and newtons, in every effect."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.design.candidates import packed_conditions
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.effects.joint_hysteresis import JointHysteresis
from calflow.effects.periodic_joint_error import PeriodicJointError
from calflow.model import build
from calflow.robot.frames import modified_dh
from calflow.robot.parts import Joint, Marker, Payload
from calflow.robot.robot import Robot

TURN, SLIDE = (
    {"mass": 20.0, "com": (0.1, 0, 0), "gear_ratio": 100.0},
    {"mass": 10.0, "com": (0, 0, 0.1), "gear_ratio": 60.0},
)
GANTRY = Robot(
    [
        Joint(modified_dh(alpha=np.pi / 2), kind="prismatic", limits=(0, 2), **SLIDE),
        Joint(modified_dh(alpha=np.pi / 2), kind="prismatic", limits=(0, 1), **SLIDE),
        Joint(modified_dh(alpha=np.pi / 2, a=0.2), limits=(-3, 3), **TURN),
        Joint(modified_dh(alpha=np.pi / 2, d=0.4), limits=(-2, 2), **TURN),
        Joint(modified_dh(alpha=-np.pi / 2), kind="prismatic", limits=(0.1, 0.5), **SLIDE),
        Joint(modified_dh(alpha=np.pi / 2, d=0.1), limits=(-3, 3), **TURN),
    ],
    payloads={"load": Payload(5.0, (0, 0, 0.1))},
    markers={"tool": Marker((0.05, 0, 0.1))},
)  # fmt: skip
LIFT_ABOVE = Robot(
    [
        Joint(modified_dh(), limits=(-3, 3)),
        Joint(modified_dh(alpha=np.pi / 2, a=0.2), kind="prismatic", limits=(0, 1)),
        Joint(modified_dh(alpha=np.pi / 2, a=0.3), limits=(-3, 3)),
    ],
    markers={"tool": Marker((0.05, 0, 0.1))},
)
SLIDES = (1, 2, 5)
UNITS = {  # of a slide's parameters and of a turning joint's
    "joint-backlash": ({"m"}, {"rad"}),
    "joint-hysteresis": ({"m"}, {"rad"}),
    "torque-backlash": ({"m"}, {"rad"}),
    "friction-wind-up": ({"m"}, {"rad"}),
    "loaded-transmission-error": (set(), {"rad"}),
    "drive-stretch": ({"m/m"}, set()),
    "nonlinear-joint-stiffness": ({"m"}, {"rad"}),
    "gear-transmission-error": ({"m"}, {"rad"}),
    "gear-ratio-error": ({"m/m"}, {"1"}),
    "housing-growth": (set(), {"m/K"}),
    "joint-compliance": ({"m/N"}, {"rad/Nm"}),
    "joint-eccentricity": (set(), {"rad"}),
    "periodic-joint-error": ({"m"}, {"rad"}),
    "gravity-deflection": (set(), {"rad", "rad/Nm"}),
    "gravity-compensator": (set(), set()),
    "wrist-coupling": ({"m/rad"}, {"1", "rad/m"}),
}


def test_a_slides_figures_are_told_by_what_they_do():
    """Fails if the turn about a slide, which no reading changes, is called the joint's zero, or its zero a length."""
    said = {f"{p.part}.{p.symbol}": p.meaning for p in catalogue()["geometry"](LIFT_ABOVE).parameters()}
    assert (said["joint2.theta"], said["joint2.d"]) == ("turn of link 2 about its slide", "zero of joint 2")
    assert (said["joint3.theta"], said["joint3.d"]) == ("zero of joint 3", "length d of link 3")


@pytest.mark.parametrize("name", UNITS)
def test_a_slides_parameters_are_lengths(name):
    """Fails if a parameter of a prismatic joint says rad, or that of a turning one m."""
    parameters = catalogue()[name](GANTRY).parameters()
    slides, turns = UNITS[name]
    assert {p.unit for p in parameters if p.joint in SLIDES} == slides
    assert {p.unit for p in parameters if p.joint not in SLIDES} <= turns


@pytest.mark.parametrize("name", [name for name, (slides, _) in UNITS.items() if slides and name != "wrist-coupling"])
def test_a_slides_error_is_drawn_against_millimetres_and_newtons(name):
    """Fails if a figure calls a slide's travel an angle, or the force on it a torque."""
    effect = catalogue()[name](GANTRY)
    for joint in range(1, 7):
        variable = effect.variable(joint)
        assert variable.unit in ({"", "mm", "N"} if joint in SLIDES else {"", "deg", "Nm"})
        if joint in SLIDES:
            assert "angle" not in variable.label
            assert "torque" not in variable.label


def test_coupling_is_drawn_against_the_joint_before():
    """Fails if the joint that a coupling comes from is given the unit of the one that it turns."""
    assert [catalogue()["wrist-coupling"](GANTRY).variable(joint).unit for joint in (5, 6)] == ["deg", "mm"]


def test_forms_are_told_in_the_units_of_their_joint():
    """Fails if a joint that turns is called a slide, or the travel over which a slide's friction develops is in degrees."""
    turns = next(k for k in range(1, 7) if k not in SLIDES)
    for slides, period, developed in (
        (True, "order 20, on a slide every 314 mm", "50 mm"),
        (False, "order 20", "2.86 deg"),
    ):
        part = f"joint{SLIDES[0] if slides else turns}"
        assert Cause(GANTRY, PeriodicJointError(GANTRY, 20.0), part).detail == period
        assert Cause(GANTRY, JointHysteresis(GANTRY, 0.05), part).detail == f"developed after {developed}"
    assert JointHysteresis(GANTRY, 0.05).detail == "developed after 50 mm or 2.86 deg"
    turning = Robot([GANTRY.joints[2]], markers=GANTRY.markers)
    assert JointHysteresis(turning, np.deg2rad(4.0)).detail == "developed after 4 deg"


def test_a_slides_backlash_moves_it_by_metres():
    """Fails if a slide's play does not shift what it carries by half of it."""
    model = build(GANTRY, ["joint-backlash"], given=("approach",))
    conditions = packed_conditions(model, np.array([[0.5, 0.5, 0.1, 0.2, 0.3, 0.4]]), "", "tool")
    conditions[-6:, 0] = [1, -1, 1, 1, 1, 1]
    at = model.position(np.zeros(6), conditions)
    for joint, sign in ((0, 1.0), (1, -1.0)):
        p = 2e-3 * (np.arange(6) == joint)
        ahead = conditions.copy()
        ahead[joint] += sign * 1e-3
        np.testing.assert_allclose(model.position(p, conditions), model.position(np.zeros(6), ahead), atol=1e-15)
        assert np.linalg.norm(model.position(p, conditions) - at) == pytest.approx(1e-3)
