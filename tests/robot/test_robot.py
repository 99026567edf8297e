"""A robot as an object: built in Python, read, written, printed and compared."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robots
from calflow.effects import catalogue
from calflow.files.problems import InputError
from calflow.robot.frames import Frame, Step, dh, modified_dh
from calflow.robot.mechanism import rated_torques
from calflow.robot.parts import Bar, Base, Coupling, Expected, FourBar, Joint, Marker, Payload
from calflow.robot.robot import Robot

FILE = """name = "slider"
notes = "two joints"
convention = "modified-dh"
tool_rotation_deg = [0, 90, 0]

[base]
origin_mm = [1000, 0, -200]
known = false

[[joints]]
name = "swivel"
d_mm = 500
limits_deg = [-170, 170]
gear_ratio = 100
rated_torque_Nm = 400
mass_kg = 40
com_mm = [10, 0, -50]

[[joints]]
kind = "prismatic"
alpha_deg = 90
a_mm = 312
limits_mm = [-50, 750]
sign = -1
mass_kg = 12

[[couplings]]
joint = 2
source = 1
factor = 0.5

[payloads."half load"]
mass_kg = 4
com_mm = [0, 20, 100]

[markers.E]
point_mm = [10, 20, 300]

[markers.F]
point_mm = [-10, 20, 300]
relative_sd_mm = 0.01

[[expected]]
effect = "geometry"
part = "joint2"
symbol = "alpha"
unit = "rad"
mean = 1.3e-4
sd = 2e-5
"""
BUILT = Robot(
    [
        Joint(modified_dh(d=0.5), limits=np.deg2rad([-170, 170]), gear_ratio=100, rated_torque=400, mass=40,
              com=[0.01, 0, -0.05], name="swivel"),
        Joint(modified_dh(alpha=np.pi / 2, a=0.312), kind="prismatic", limits=[-0.05, 0.75], sign=-1, mass=12),
    ],
    name="slider",
    notes="two joints",
    base=Base([1, 0, -0.2], known=False),
    couplings=[Coupling(2, 1, 0.5)],
    tool_rotation=[0, np.pi / 2, 0],
    payloads={"half load": Payload(4, [0, 0.02, 0.1])},
    markers={"E": Marker((0.01, 0.02, 0.3)), "F": Marker(np.array([-0.01, 0.02, 0.3]), relative_sd=1e-5)},
    expected=[Expected("geometry", "joint2", "alpha", "rad", mean=1.3e-4, sd=2e-5)],
)  # fmt: skip


@pytest.fixture
def read(tmp_path):
    """The robot of the file above."""
    (tmp_path / "robot.toml").write_text(FILE)
    return Robot.from_toml(str(tmp_path / "robot.toml"))


def test_a_robot_built_in_python_equals_the_file(read):
    """Fails if a unit, a default or the order of a mapping differs between the two ways to state a robot."""
    assert read == BUILT
    assert hash(read) == hash(BUILT)
    assert read.canonical() == BUILT.canonical()


def test_defaults_are_a_robot_that_stands_level_at_the_origin():
    """Fails if a robot of joints and one marker is not enough, or stands elsewhere."""
    robot = Robot(joints=[Joint(modified_dh(a=0.5))], markers={"tool": Marker((0, 0, 0.1))})
    assert (robot.name, robot.gravity) == ("robot", (0.0, 0.0, -9.80665))
    assert robot.base == Base((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), known=True)
    assert robot.limits.tolist() == [[-np.pi, np.pi]]


@pytest.mark.parametrize(
    "robot",
    [BUILT, robots.hh800(), robots.hh800_with_bars(0.75, 1.7, 0.9, "crossed"), robots.ur10(), robots.palletiser(),
     replace(robots.industrial(), base=robots.ASKEW, notes='a "quoted"\nnote\twith \\ and €'),
     replace(BUILT, gravity=(0.1, 0.2, -9.7))],
)  # fmt: skip
def test_a_written_robot_reads_back_equal(robot, tmp_path):
    """Fails if a field is left out on writing, or a figure is not the same to the last bit."""
    robot.to_toml(str(tmp_path / "robot.toml"))
    assert Robot.from_toml(tmp_path / "robot.toml") == robot


FIGURE = st.floats(-4, 4)


@settings(deadline=None, max_examples=100)
@given(st.tuples(*[FIGURE] * 6), st.tuples(*[FIGURE] * 3))
def test_any_figure_reads_back_equal(tmp_path_factory, figures, point):
    """Fails if a figure that no short number of mm or degrees means is rounded."""
    alpha, a, d, theta, beta, limit = figures
    frame = dh(alpha=alpha, a=a, d=d, theta=theta, beta=beta)
    joints = [Joint(frame, limits=(limit, 5.0)), Joint(frame, kind="prismatic", limits=(limit, 5.0), com=point)]
    robot = Robot(joints, markers={"tool": Marker(point)})
    path = tmp_path_factory.mktemp("robot") / "robot.toml"
    robot.to_toml(path)
    assert Robot.from_toml(path) == robot


def test_a_written_file_has_the_units_of_a_drawing(read, tmp_path):
    """Fails if a file that was read in mm and degrees comes back in m and radians, or with figures nobody stated."""
    read.to_toml(tmp_path / "written.toml")
    written = (tmp_path / "written.toml").read_text()
    for line in ("d_mm = 500.0", "alpha_deg = 90.0", "limits_deg = [-170.0, 170.0]", "limits_mm = [-50.0, 750.0]",
                 "com_mm = [10.0, 0.0, -50.0]", "relative_sd_mm = 0.01", '[payloads."half load"]'):  # fmt: skip
        assert line in written.splitlines()
    assert "beta" not in written
    assert "gravity" not in written


def test_what_nobody_knows_is_written_as_such(tmp_path):
    """Fails if an unknown mass or marker comes back as a known one."""
    unknown = replace(
        BUILT, payloads={"tool": Payload(None, [0, 0, 0.1])}, markers={"E": Marker((0, 0, 0), known=False)}
    )
    unknown.to_toml(tmp_path / "unknown.toml")
    written = (tmp_path / "unknown.toml").read_text().splitlines()
    assert 'mass_kg = "unknown"' in written
    assert written.count("known = false") == 2
    assert Robot.from_toml(tmp_path / "unknown.toml") == unknown
    assert not unknown.has_masses
    assert "tool of unknown mass" in repr(unknown)


def test_a_first_joint_along_the_bases_z_asks_for_gravity(tmp_path):
    """Fails if the gravity of a robot on a rail is taken along the rail without a word, or a lift cannot say what it is."""
    rail = replace(BUILT, joints=[BUILT.joints[1], BUILT.joints[0]])
    upright = replace(rail, joints=[replace(rail.joints[0], frame=modified_dh()), rail.joints[1]])
    for robot in (rail, upright, replace(upright, gravity=(0, -9.8, 0))):
        path = tmp_path / "rail.toml"
        robot.to_toml(path)
        assert Robot.from_toml(path) == robot
        path.write_text("\n".join(line for line in path.read_text().splitlines() if "gravity" not in line))
        if robot is rail:
            assert Robot.from_toml(path) == robot
        else:
            with pytest.raises(InputError, match="expected gravity"):
                Robot.from_toml(path)


def test_frames_of_no_convention_read_back_equal(tmp_path):
    """Fails if a step, which of a frame's errors are parameters, or how tables list them is lost."""
    turn = Step("rz", "theta", 0.3, ("middle", "last"))
    own = Joint(Frame(turn, mount=(Step("tx", "x", 0.1, ("last",)), Step("ty", "y", -0.2)), listed=("theta", "x")))
    marker = {"tool": Marker((0, 0, 0.1))}
    slide = Joint(
        Frame(Step("rz", "r"), body=(Step("tz", "s"), Step("rx", "u", 1 / 3))), kind="prismatic", limits=(0, 1)
    )
    for joints in ([Joint(dh(alpha=0.4)), own], [Joint(dh()), Joint(modified_dh())], [slide, own]):
        robot = Robot(joints, name="odd", markers=marker)
        robot.to_toml(tmp_path / "robot.toml")
        assert Robot.from_toml(tmp_path / "robot.toml") == robot
    written = (tmp_path / "robot.toml").read_text()
    assert '  {part = "mount", motion = "tx", symbol = "x", shift_mm = 100.0, free = ["last"]},' in written
    for old, new, said in (
        ("steps = [", "a_mm = 3\nsteps = [", "'a' is of a convention"),
        ('motion = "tx", symbol = "x", shift_mm', 'motion = "rx", symbol = "x", shift_mm', "a motion rx has turn_deg"),
        ('convention = "frames"', 'convention = "dh"', 'joint 1: steps go with convention = "frames"'),
        ('part = "turn"', 'part = "mount"', "one of turn"),
        ("gravity =", "# gravity =", "expected gravity"),
    ):
        assert old in written
        (tmp_path / "wrong.toml").write_text(written.replace(old, new, 1))
        with pytest.raises(InputError, match=said):
            Robot.from_toml(tmp_path / "wrong.toml")


def test_limits_in_two_units_are_refused(tmp_path):
    """Fails if one of two statements of the same limits wins in silence."""
    (tmp_path / "robot.toml").write_text(FILE.replace("limits_mm", "limits_m = [0, 1]\nlimits_mm"))
    with pytest.raises(InputError, match=r"joints\[2\]\.limits_mm: 'limits' is given twice"):
        Robot.from_toml(tmp_path / "robot.toml")


def test_equality_sees_every_difference():
    """Fails if two robots that differ count as the same where results are kept by robot."""
    loop = FourBar(2, Bar(0.5), Bar(1.0), 0.5)
    changes = {
        "name": "other", "notes": "", "gravity": (0, 0, -9.8), "base": Base(), "couplings": (), "tool_rotation": None, "loop": loop,
        "joints": BUILT.joints[::-1], "expected": (), "payloads": {}, "markers": {"E": Marker((0, 0, 0))},
    }  # fmt: skip
    for name, value in changes.items():
        other = replace(BUILT, **{name: value})
        assert other != BUILT
        assert other.canonical() != BUILT.canonical()
    loads = {"light": Payload(1), "heavy": Payload(2)}
    assert replace(BUILT, payloads=loads) != replace(BUILT, payloads=dict(reversed(loads.items())))
    assert pickle.loads(pickle.dumps(BUILT)) == BUILT


def test_effects_of_equal_robots_are_equal(read):
    """Fails if an effect cannot be found in a model, or kept, by what it is of."""
    for kind in catalogue().values():
        assert kind(read) == kind(BUILT)
        assert hash(kind(read)) == hash(kind(BUILT))


def test_what_it_is_made_of_cannot_be_changed():
    """Fails if a robot changes under an effect that holds it."""
    with pytest.raises(AttributeError):
        BUILT.name = "other"
    with pytest.raises(TypeError):
        BUILT.markers["E"] = Marker((0, 0, 0))
    markers = {"tool": Marker((0, 0, 0.1))}
    robot = replace(BUILT, markers=markers)
    markers["second"] = Marker((0, 0, 0.2))
    assert list(robot.markers) == ["tool"]


def test_rated_torques_are_worked_out_once():
    """Fails if every effect that asks for a robot's rated torques has them computed anew, or can change them for others."""
    rated = rated_torques(robots.ur10())
    assert rated_torques(robots.ur10()) is rated
    with pytest.raises(ValueError, match="read-only"):
        rated[0] = 1.0


def test_a_robot_prints_as_its_drawing_says():
    """Fails if figures are printed in SI, a joint, its limits, a payload or a marker is missing, or HTML is not escaped."""
    assert repr(BUILT).splitlines() == [
        "Robot 'slider': 2 joints, modified-dh",
        "     joint  alpha [deg]  a [mm]  beta [deg]  d [mm]  theta [deg]          limits",
        "  1 swivel            0       0           0     500            0  -170 … 170 deg",
        "         2           90     312           0       0            0    -50 … 750 mm",
        "payloads: half load 4 kg",
        "markers: E (10, 20, 300) mm, F (-10, 20, 300) mm",
    ]
    html = replace(BUILT, name="<b>")._repr_html_()
    assert "&lt;b&gt;" in html
    assert html.count("<tr>") == 3
    own = Frame(turn=Step("rz", "theta", np.pi), mount=(Step("tx", "x", 0.1),))
    assert "x 100 mm, theta 180 deg" in repr(Robot([Joint(own)], markers={"tool": Marker((0, 0, 0))}))


def test_all_impossible_values_are_told_at_once():
    """Fails if a scientist has to come back for the next mistake, or is not told where it is."""
    turn_about_x = Frame(turn=Step("rx", "theta"))
    joints = [
        Joint(modified_dh(a=np.nan), limits=(1, -1), mass=-30, sign=2),
        Joint(dh(), kind="prismatic"),
        Joint(dh(), kind="sliding", com=(1, 2), gear_ratio=0),
        Joint(turn_about_x),
        "joint",
        Joint(Frame(turn=Step("rz", "theta")), kind="prismatic", limits=(0, 1)),
    ]
    with pytest.raises(InputError) as refused:
        Robot(
            joints,
            name="odd",
            gravity=(0, 0, np.inf),
            base=Base("here"),
            couplings=[Coupling(1, 9, 1.0)],
            loop=FourBar(1, Bar(0), Bar(1.0, mass="heavy"), -1.0, assembly="shut"),
            payloads={"load": Payload(-1)},
            markers={"base": Marker((0, 0, 0), relative_sd=1e-5)},
        )
    told = [str(problem).removeprefix("robot 'odd': ") for problem in refused.value.problems]
    assert told == [
        "joints[1].frame.a: expected a finite number, found nan",
        "joints[1].limits: expected lower < upper, found 1 and -1",
        "joints[1].sign: expected 1 or -1, found 2",
        "joints[1].mass: expected a number greater than or equal to 0, found -30",
        "joints[2]: a prismatic joint needs limits [m]",
        "joints[3].gear_ratio: expected a number greater than 0, found 0",
        "joints[3].com: value 3 is missing",
        "joints[3].kind: expected 'revolute' or 'prismatic', found 'sliding'",
        "joints[4].frame.turn: expected a turn about z, found rx",
        "joints[5]: expected a Joint, found 'joint'",
        "joints[6].frame: expected a shift along z in its body, along which a prismatic joint moves",
        "gravity[3]: expected a finite number, found inf",
        "base.origin: expected several numbers, found 'here'",
        "couplings[1].source: there is no joint 9: this robot has joints 1 to 6",
        "payloads.load.mass: expected a number greater than or equal to 0, found -1",
        "markers: a marker cannot be called 'base': parameters are named by their part",
        "markers: the first marker has no relative_sd: the others' places are relative to it",
        "loop.joint: expected a number greater than or equal to 2, found 1",
        "loop.crank.length: expected a number greater than 0, found 0",
        "loop.rod.mass: expected a number, found 'heavy'",
        "loop.rocker: expected a number greater than 0, found -1.0",
        "loop.assembly: expected 'open' or 'crossed', found 'shut'",
    ]
    for nothing in ([], None, "joints"):
        with pytest.raises(InputError, match="joints: expected at least one Joint"):
            Robot(nothing, markers={"tool": Marker((0, 0, 0))})
    with pytest.raises(InputError, match="markers: expected at least one marker"):
        Robot([Joint(dh())])
