"""A torso with two arms by physics of its own in numpy: what is wrong on one branch is found there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.measurements.series import Series
from hidden.devices import measured as device_rows
from hidden.devices import rows
from hidden.trials import calibrated

Array = np.ndarray
GRAVITY = np.array([0.0, 0.0, -9.80665])
NOISE = 3e-5  # m
ARM = (
    (0.13, 0.0, 90.0, 7.0),
    (0.0, -0.6, 0.0, 11.0),
    (0.1, -0.55, 90.0, 4.0),
    (0.12, 0.0, 0.0, 2.0),
)  # d, a, alpha, mass
TORSO = (0.8, 0.0, 90.0, 25.0)
PARENTS = (0, 1, 2, 3, 4, 1, 6, 7, 8)  # links, 0 the base
HANDS = {"left": (5, (0.02, 0.0, 0.1)), "right": (9, (0.0, 0.03, 0.1))}
SHOULDER = (0.0, 0.05, -0.2), (np.pi, 0.0, 0.0)  # of the right arm on the torso
LOAD, LOAD_AT = 5.0, (0.0, 0.0, 0.1)  # in the right hand


def robot() -> cf.Robot:
    """The robot as its maker says."""
    joints = []
    for i, (d, a, alpha, mass) in enumerate((TORSO, *ARM, *ARM), start=1):
        frame = cf.dh(d=d, a=a, alpha=np.deg2rad(alpha))
        frame = cf.at_origin(frame, *SHOULDER) if i == 6 else frame
        link = {1: "torso", **{hand: name for name, (hand, _) in HANDS.items()}}.get(i, "")
        joints.append(cf.Joint(frame, link=link, parent="torso" if i == 6 else "", limits=(-2.2, 2.2), mass=mass,
                               com=(-a / 2, 0.0, 0.02)))  # fmt: skip
    markers = {name: cf.Marker(point, on=name) for name, (_, point) in HANDS.items()}
    payloads = {"box": cf.Payload(LOAD, LOAD_AT, on="right")}
    return cf.Robot(joints=joints, markers=markers, payloads=payloads, base=cf.Base(known=False))


def frame(turn: Rotation, place: object = (0.0, 0.0, 0.0)) -> Array:
    """A transform (4, 4)."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn.as_matrix(), place
    return made


def point_of_link(
    before: list[Array], after: list[Array], parents: tuple[int, ...], q: Array, link: int, point: object
) -> Array:
    """Where a point of a link of a tree is, (n, 3), by what stands before and after each joint's turn (n, joints)."""
    place = np.append(point, 1.0)[None, :, None]
    while link:
        turn = np.tile(np.eye(4), (len(q), 1, 1))
        turn[:, :3, :3] = Rotation.from_rotvec(np.outer(q[:, link - 1], [0, 0, 1])).as_matrix()
        place = before[link - 1] @ turn @ after[link - 1] @ place
        link = parents[link - 1]
    return np.asarray(place[:, :3, 0])


@dataclass(frozen=True)
class Arms:
    """The robot as it is: what stands before and after each joint's turn, and its springs' compliances [rad/Nm]."""

    before: list[Array]
    after: list[Array]
    compliance: Array
    base: Array
    markers: dict[str, tuple[int, Array]]
    masses: Array

    @staticmethod
    def made(rng: np.random.Generator) -> Arms:
        """Make one, each of whose frames is off by some 0.3 mm and mrad."""

        def off() -> Array:
            return frame(Rotation.from_rotvec(3e-4 * rng.normal(size=3)), 3e-4 * rng.normal(size=3))

        links = (TORSO, *ARM, *ARM)
        stands = frame(Rotation.from_euler("XYZ", SHOULDER[1]), SHOULDER[0])
        return Arms(
            [(stands if i == 5 else np.eye(4)) @ off() for i in range(9)],
            [frame(Rotation.from_euler("x", alpha, degrees=True), (a, 0, d)) @ off() for d, a, alpha, _ in links],
            rng.uniform(2e-6, 8e-6, 9),
            frame(Rotation.random(random_state=rng), rng.normal(size=3)),
            {name: (link, point + 1e-3 * rng.normal(size=3)) for name, (link, point) in HANDS.items()},
            np.array([link[3] for link in links]),
        )

    def at(self, q: Array) -> tuple[list[Array], list[Array]]:
        """The frames of the joints, turned, and of the links, the base's first, (n, 4, 4) each, by joint angles (n, 9)."""
        joints, links = [], [np.eye(4)]
        for i, parent in enumerate(PARENTS):
            turn = np.tile(np.eye(4), (len(q), 1, 1))
            turn[:, 0, 0] = turn[:, 1, 1] = np.cos(q[:, i])
            turn[:, 1, 0] = np.sin(q[:, i])
            turn[:, 0, 1] = -turn[:, 1, 0]
            joints.append(links[parent] @ self.before[i] @ turn)
            links.append(joints[i] @ self.after[i])
        return joints, links

    def placed(self, q: Array, link: int, point: object) -> Array:
        """Where a point of a link is, (n, 3), by joint angles (n, 9) as they are; the base at rest."""
        return point_of_link(self.before, self.after, PARENTS, q, link, point)

    def torque(self, q: Array, carries: Array) -> Array:
        """What gravity exerts on each joint (n, 9) [Nm], body by body, down to the base; carries (n,): the load, or not."""
        joints, links = self.at(q)
        found, whole = np.zeros(q.shape), np.ones(len(q))
        bodies = [
            (i + 1, mass * whole, (-link[1] / 2, 0, 0.02))
            for i, (mass, link) in enumerate(zip(self.masses, (TORSO, *ARM, *ARM), strict=True))
        ]
        for link, mass, centre in [*bodies, (9, LOAD * carries, LOAD_AT)]:
            place = (links[link] @ [*centre, 1.0])[:, :3]
            while link:
                axis, origin = joints[link - 1][:, :3, 2], joints[link - 1][:, :3, 3]
                found[:, link - 1] += mass * (axis * np.cross(place - origin, GRAVITY)).sum(axis=1)
                link = PARENTS[link - 1]
        return found

    def seen(self, q: Array, carries: Array, marker: str, hidden: Callable[[Array, Array], Array]) -> Array:
        """Where a marker is (n, 3) [m] once the springs have given way; hidden is what is wrong besides, by angles and torques."""
        turned = q
        for _ in range(8):
            torque = self.torque(turned, carries)
            turned = q + self.compliance * torque + hidden(q, torque)
        link, point = self.markers[marker]
        return np.asarray((self.base @ self.at(turned)[1][link] @ [*point, 1.0])[:, :3])


def measured(seed: int, hidden: Callable[[Array, Array], Array], poses: int = 70) -> cf.Measurements:
    """Both hands measured at random poses, with and without the load."""
    rng = np.random.default_rng(seed)
    real, of = Arms.made(rng), robot()
    q, carries = rng.uniform(*of.limits.T, (poses, 9)), rng.uniform(size=poses) < 0.5
    rows = [(k, name) for k in range(poses) for name in HANDS]
    position = np.stack([real.seen(q, carries, name, hidden) for name in HANDS], axis=1).reshape(-1, 3)
    position += NOISE * rng.normal(size=position.shape)
    return cf.Measurements.from_arrays(
        of, q[[k for k, _ in rows]], position, pose=[k for k, _ in rows], marker=[name for _, name in rows],
        payload=["box" if carries[k] else "" for k, _ in rows], sigma=NOISE,
    ).split(holdout=0.25, seed=1)  # fmt: skip


def touching(seed: int, starts: int = 600) -> cf.Measurements:
    """The left hand's tip in a cup on the right hand, nobody knows where; no device sees either, and nothing gives way."""
    rng = np.random.default_rng(seed)
    real, of = Arms.made(rng), robot()
    (left, tip), (right, _) = real.markers["left"], HANDS["right"]
    seat = NOISE * rng.normal(size=(starts, 3))

    def apart(q: Array) -> Array:
        return real.placed(q, left, tip) - real.placed(q, right, (0.05, -0.02, 0.12)) + seat

    q, own = rng.uniform(*of.limits.T, (starts, 9)), np.eye(9)[1:5]  # the left arm goes to the right one
    for _ in range(30):
        slope = np.stack([(apart(q + 1e-6 * way) - apart(q)) / 1e-6 for way in own], axis=2)
        q = q - np.clip(np.einsum("nji,ni->nj", np.linalg.pinv(slope, rcond=1e-2), apart(q)), -0.3, 0.3) @ own
    met = (np.linalg.norm(apart(q), axis=1) < 1e-9) & ((q > of.limits[:, 0]) & (q < of.limits[:, 1])).all(axis=1)
    series = Series.of("cup", "same-point", {"on": "right"})
    return device_rows(of, rows(q[met]).assign(socket="cup"), series, NOISE)


def nothing(q: Array, torque: Array) -> Array:
    """Nothing is wrong."""
    return np.zeros(q.shape)


def eccentric(q: Array, torque: Array) -> Array:
    """Joint 7, the right arm's second, errs once a turn."""
    return 3e-4 * np.sin(q + 0.7) * (np.arange(9) == 6)


def rms(apart: Array) -> float:
    """The root mean square length of vectors (n, 3)."""
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def heldout(calibration: cf.Calibration) -> float:
    """The mean error of poses that no fit has seen [m]."""
    return [1e-3 * row.mean for row in calibration.accuracy if row.split == "holdout"][-1]


SEED = 3


@pytest.fixture(scope="module")
def found() -> cf.Calibration:
    """Both arms identified."""
    return cf.identify(robot(), measured(SEED, nothing), effects=["geometry", "joint-compliance"], starts=1)


@pytest.fixture(scope="module")
def real() -> Arms:
    """The robot of that measurement as it is."""
    return Arms.made(np.random.default_rng(SEED))


def test_two_arms_are_identified_to_the_noise(found):
    """Fails if a branch's errors, its springs or the torso's that both arms load are not found: by mechanics of the test's own."""
    assert heldout(found) < 1.5 * 2 * np.sqrt(2 / np.pi) * NOISE  # the mean length of three normal errors


@pytest.mark.parametrize("hand", HANDS)
def test_each_hand_is_predicted_and_brought_to_its_target(found, real, hand):
    """Fails if a hand is predicted as the other, with a load or springs that are not its own, or its joints are not those moved."""
    rng = np.random.default_rng(8)
    q, loaded = rng.uniform(-1.6, 1.6, (20, 9)), np.ones(20)
    aim = real.seen(q, loaded, hand, nothing)
    predicted = found.predict(q, marker=hand, payload="box")
    expected = np.sqrt((predicted.sd**2).sum(axis=1).mean())
    assert 0.3 * expected < rms(predicted.position - aim) < 1.5 * expected < 1.5 * NOISE
    begun = q + 0.02 * rng.standard_normal(q.shape)
    commands = found.compensate(aim, start=begun, marker=hand, payload="box")
    assert commands.reached.all()
    landed = real.seen(commands.readings, loaded, hand, nothing)
    assert rms(landed - aim) < 1.5 * expected
    others = {"left": slice(5, 9), "right": slice(1, 5)}[hand]
    np.testing.assert_allclose(commands.readings[:, others], begun[:, others], atol=1e-9)


def test_poses_are_chosen_for_the_hand_that_is_measured(found, real):
    """Fails if poses that are to be measured by one hand are chosen for what the other shows: they tell less than any at random."""

    def information(q: Array) -> float:
        """The logarithm of what the right hand's points tell of where the robot stands and of its zeros, but the torso's."""
        link, point = real.markers["right"]
        at = real.placed(q, link, point)
        by_joint = [(real.placed(q + 1e-6 * way, link, point) - at) / 1e-6 for way in np.eye(9)[5:]]
        by_turn = [np.cross(axis, at) for axis in np.eye(3)]
        slopes = np.stack([*by_joint, *by_turn, *(np.tile(axis, (len(q), 1)) for axis in np.eye(3))], axis=2)
        return float(np.linalg.slogdet(np.einsum("nij,nik->jk", slopes, slopes))[1])

    chosen = found.select(24, marker="right", candidates=400)
    assert set(chosen.poses["marker"]) == {"right"}
    rng = np.random.default_rng(5)
    by_chance = [information(rng.uniform(*robot().limits.T, (24, 9))) for _ in range(40)]
    assert information(chosen.readings) > max(by_chance)


def test_an_arm_that_touches_the_other_calibrates_both():
    """Fails if a cup that rides on the other hand is taken to stand still, or an arm's errors are not found from touches."""
    data = touching(5)
    assert len(data) > 60
    fitted = calibrated(data, ("geometry",))
    found = fitted.fit
    squared = float((found.residual**2).sum()) / (found.residual.size - found.effective_parameters)
    assert 0.6 < squared < 1.5
    assert fitted.left < 1.3 * NOISE


def test_what_is_wrong_on_one_arm_is_found_there():
    """Fails if an arm's cause is missed, or taken for one of the other arm's or the torso's."""
    fitted = cf.identify(robot(), measured(1, eccentric), effects=["geometry", "joint-compliance"], starts=1)
    better = fitted.diagnose(false_alarm=0.01, catalogue=["joint-eccentricity", "gear-ratio-error", "link-torsion"])
    assert [(one.cause, one.joint) for one in better.findings][:1] == [("joint-eccentricity", 7)]
    assert all(rival.joint in (0, 7) for rival in better.findings[0].rivals)
    assert better.findings[0].estimate == pytest.approx(3e-4, abs=4 * better.findings[0].sd)
