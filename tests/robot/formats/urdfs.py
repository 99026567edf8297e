"""URDF files to test with: random trees of links, and what pinocchio makes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

Q = "revolute", "continuous", "prismatic"


def joint(name: str, kind: str, parent: str, child: str, rng: np.random.Generator, mimic: str = "") -> str:
    """A joint at a random origin about a random or a coordinate axis, a third of them parallel to the one before."""
    xyz = rng.uniform(-0.6, 0.6, 3) if rng.uniform() < 0.8 else np.zeros(3)
    rpy = rng.uniform(-3, 3, 3) if rng.uniform() < 0.4 else rng.choice([0, np.pi / 2, -np.pi / 2, np.pi], 3)
    rpy = np.zeros(3) if rng.uniform() < 0.33 else rpy
    axis = rng.normal(size=3) if rng.uniform() < 0.3 else rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)]
    limit = "" if kind in ("continuous", "fixed") else '<limit lower="-2.5" upper="2.5" effort="1" velocity="1"/>'
    moving = "" if kind == "fixed" else f"<axis xyz='{_text(axis)}'/>{limit}{mimic}"
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>\n'
        f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>{moving}</joint>\n'
    )


def link(name: str, rng: np.random.Generator, weighs: bool = True) -> str:
    """A link, with a random mass."""
    if not weighs:
        return f'<link name="{name}"/>\n'
    com, mass = _text(rng.uniform(-0.3, 0.3, 3)), rng.uniform(0.1, 8)
    still = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    return f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>{still}</inertial></link>\n'


def tree(seed: int) -> str:
    """A chain from `world` to `tip` of five to seven moving joints with fixed ones between, and branches beside it."""
    rng = np.random.default_rng(seed)
    text, at = link("world", rng, weighs=False), "world"
    kinds = rng.permutation([*rng.choice(Q, rng.integers(4, 7), p=[0.6, 0.2, 0.2]), "revolute", "fixed", "fixed"])
    for n, kind in enumerate(kinds, start=1):
        text += link(f"l{n}", rng, weighs=bool(kind != "fixed" or rng.uniform() < 0.5)) + joint(
            f"j{n}", str(kind), at, f"l{n}", rng
        )
        if rng.uniform() < 0.3:  # a branch: a camera, or a finger
            beside = str(rng.choice(["fixed", "revolute", "prismatic"]))
            text += link(f"b{n}", rng) + joint(f"jb{n}", beside, f"l{n}", f"b{n}", rng)
        at = f"l{n}"
    text += link("tip", rng, weighs=False) + joint("jt", "fixed", at, "tip", rng)
    return f'<?xml version="1.0"?>\n<robot name="tree {seed}">\n{text}</robot>\n'


def cell(seed: int) -> str:
    """A positioner that tilts and turns a `piece`, and an arm on a rail up to `tip`, both on the floor `world`."""
    rng = np.random.default_rng(seed)
    text = link("world", rng, weighs=False)
    for names, joints, end in (
        (("tilted", "turned"), ("tilt", "turn"), "piece"),
        (("wagon", *(f"l{k}" for k in range(1, 7))), ("rail", *(f"j{k}" for k in range(1, 7))), "tip"),
    ):
        at = "world"
        for name, own in zip(names, joints, strict=True):
            text += link(name, rng, weighs=name != "turned")
            text += joint(own, "prismatic" if own == "rail" else "revolute", at, name, rng)
            at = name
        text += link(end, rng, weighs=False) + joint(f"to_{end}", "fixed", at, end, rng)
    return f'<?xml version="1.0"?>\n<robot name="cell {seed}">\n{text}</robot>\n'


def arms(seed: int) -> str:
    """A torso on a lift with two arms, to `left_tip` and `right_tip`, and a head to `eye`; right fingers follow left ones.

    The second arm begins on the same link as the first, the head on that before it: on the base of every third.
    """
    rng = np.random.default_rng(seed)
    text = link("world", rng, weighs=False)
    for name, parent, kind in (("lift", "world", "prismatic"), ("torso", "lift", "revolute")):
        text += link(name, rng) + joint(f"to_{name}", kind, parent, name, rng)
    for side, begins, number in (
        ("left", "torso", 4),
        ("right", "torso", 4),
        ("head", ("lift", "torso", "world")[seed % 3], 2),
    ):
        at = begins
        for k in range(1, number + 1):
            follows = f'<mimic joint="left{k}" multiplier="-0.7"/>' if side == "right" and k == number else ""
            kind = str(rng.choice(Q, p=[0.7, 0.15, 0.15])) if not follows else "revolute"
            text += link(f"{side}_link{k}", rng) + joint(f"{side}{k}", kind, at, f"{side}_link{k}", rng, follows)
            at = f"{side}_link{k}"
        tip = "eye" if side == "head" else f"{side}_tip"
        text += link(tip, rng, weighs=side == "right") + joint(f"to_{tip}", "fixed", at, tip, rng)
    return f'<?xml version="1.0"?>\n<robot name="arms {seed}">\n{text}</robot>\n'


class Reference:
    """A URDF as pinocchio has it; q are the variables of some joints by name, all others are at zero."""

    def __init__(self, path: Path, names: list[str]) -> None:
        self.model = pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()
        self.joints = [self.model.joints[self.model.getJointId(name)] for name in names]

    def _whole(self, q: np.ndarray) -> np.ndarray:
        whole = pin.neutral(self.model)
        for one, value in zip(self.joints, q, strict=True):
            whole[one.idx_q : one.idx_q + one.nq] = [np.cos(value), np.sin(value)] if one.nq == 2 else [value]
        return whole

    def frame(self, q: np.ndarray, link: str, base: str = "") -> np.ndarray:
        """A link's frame (4, 4), as the root sees it or another link."""
        pin.framesForwardKinematics(self.model, self.data, self._whole(q))
        at = self.data.oMf[self.model.getFrameId(link)]
        return (self.data.oMf[self.model.getFrameId(base)].inverse() * at if base else at).homogeneous

    def torque(self, q: np.ndarray) -> np.ndarray:
        """What holds the joints still in gravity [Nm, N]."""
        self.model.gravity.linear = np.array([0, 0, -9.80665])
        held = pin.computeGeneralizedGravity(self.model, self.data, self._whole(q))
        return np.array([held[one.idx_v] for one in self.joints])


def _text(values: np.ndarray) -> str:
    return " ".join(map(repr, map(float, values)))
