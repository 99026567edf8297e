"""MJCF, MuJoCo's format.

A rigid chain is written as bodies within bodies; a model is read by MuJoCo itself, as the URDF that it states.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from calflow.files.deferred import Rotation
from calflow.files.problems import refuse, regular_file
from calflow.robot.formats.rigid_chain import (
    BASE,
    MEASURING,
    TOOL,
    RigidChain,
    commented,
    figures_text,
    marked,
    shift,
    urdf_joint,
    urdf_link,
    urdf_mass,
    xml_text,
)

SUFFIX = ".xml"
LEAST_MASS = 1e-3  # kg, and kg m² a thousandth of it: what MuJoCo asks of a body that moves, where nobody stated it


def mjcf_text(chain: RigidChain, notes: str) -> str:
    """Return a rigid chain as MJCF: body `base_link`, in it `link1` …, each with its joint; flanges, tool0 and markers are sites.

    notes stand in a comment. Shapes and inertia are not known to calflow: MuJoCo gives bodies without a mass LEAST_MASS.
    """
    model = ElementTree.Element("mujoco", model=chain.name)
    model.append(ElementTree.Comment(commented(notes)))
    ElementTree.SubElement(
        model,
        "compiler",
        angle="radian",
        autolimits="true",
        boundmass=repr(LEAST_MASS),
        boundinertia=repr(1e-3 * LEAST_MASS),
    )
    bodies = [ElementTree.SubElement(ElementTree.SubElement(model, "worldbody"), "body", name=BASE)]
    _site(bodies[0], MEASURING, np.linalg.inv(chain.base))
    for i, joint in enumerate(chain.joints):
        body = ElementTree.SubElement(bodies[joint.on], "body", {"name": f"link{i + 1}", **_place(joint.origin)})
        if joint.mass:
            still = figures_text([1e-3 * LEAST_MASS] * 3)
            ElementTree.SubElement(
                body, "inertial", pos=figures_text(joint.com), mass=repr(float(joint.mass)), diaginertia=still
            )
        limits = {"range": figures_text(joint.limits)} if joint.limits else {}
        kind = "hinge" if joint.kind == "revolute" else "slide"
        ElementTree.SubElement(
            body, "joint", {"name": joint.name, "type": kind, "axis": figures_text(joint.axis), **limits}
        )
        bodies.append(body)
    for link, (name, at) in chain.flanges.items():
        _site(bodies[link], name, at)
    last = bodies[len(chain.joints)]
    _site(last, TOOL, chain.flange @ chain.tool)
    for name, (link, point) in marked(chain):
        _site(bodies[link], f"marker_{name}", chain.flanges[link][1] @ shift(point))
    if leaders := [joint for joint in chain.joints if joint.leader]:
        equality = ElementTree.SubElement(model, "equality")
        for joint in leaders:
            assert joint.leader
            polynomial = figures_text([0, joint.leader[1], 0, 0, 0])
            ElementTree.SubElement(equality, "joint", joint1=joint.name, joint2=joint.leader[0], polycoef=polynomial)
    return xml_text(model)


def _site(body: ElementTree.Element, name: str, at: np.ndarray) -> None:
    ElementTree.SubElement(body, "site", {"name": name, **_place(at)})


def _place(at: np.ndarray) -> dict[str, str]:
    turn = Rotation.from_matrix(at[:3, :3]).as_quat(canonical=True, scalar_first=True)
    return {"pos": figures_text(at[:3, 3]), "quat": figures_text(turn)}


def urdf_of_mjcf(path: Path) -> str:
    """Return the URDF of a model: a link a body and a site, joints at the model's own zero, masses and centres, followers by mimic.

    Shapes are left out. A body with several joints has a link between each two.

    Raises:
        InputError: MuJoCo cannot read it, or is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise refuse("is MJCF, which the extra 'mjcf' reads: pip install calflow[mjcf]", path) from None
    try:
        model = mujoco.MjModel.from_xml_path(str(regular_file(path)))
    except ValueError as error:
        raise refuse(f"MuJoCo cannot read it: {' '.join(str(error).split())}", path) from None
    robot = ElementTree.Element("robot", name=path.stem)
    names = _names(model)
    for body in range(model.nbody):
        _body(robot, model, names, body)
    for site in range(model.nsite):
        at = _transform(model.site_pos[site], model.site_quat[site])
        name = names["site", site]
        urdf_link(robot, name)
        urdf_joint(robot, f"{name}-site", "fixed", names["body", int(model.site_bodyid[site])], name, at)
    for follower, leader, multiplier, offset in _followers(model):
        made = next(element for element in robot.iter("joint") if element.get("name") == names["joint", follower])
        mimic = {"joint": names["joint", leader], "multiplier": repr(multiplier), "offset": repr(offset)}
        ElementTree.SubElement(made, "mimic", mimic)
    return xml_text(robot)


Names = dict[tuple[str, int], str]  # of a model's things, by kind and number


def _names(model: Any) -> Names:
    """The names of bodies, sites and joints as URDF needs them: each has one, and no two links the same."""
    names: Names = {}
    links, joints = set[str](), set[str]()
    for kind, number in {"body": model.nbody, "site": model.nsite, "joint": model.njnt}.items():
        taken = joints if kind == "joint" else links
        for k in range(number):
            name = getattr(model, kind)(k).name or f"{kind}{k}"
            while name in taken:
                name = f"{name}_{kind}"
            taken.add(name)
            names[kind, k] = name
    return names


def _body(robot: ElementTree.Element, model: Any, names: Names, body: int) -> None:
    """A body's link, with what it hangs by."""
    link = urdf_link(robot, names["body", body])
    if model.body_mass[body] > 0:
        urdf_mass(link, model.body_mass[body], model.body_ipos[body])
    if body == 0:
        return
    at, on = _transform(model.body_pos[body], model.body_quat[body]), names["body", int(model.body_parentid[body])]
    first, number = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    for joint in range(first, first + number):
        anchor = shift(model.jnt_pos[joint])
        centred = joint == first + number - 1 and not model.jnt_pos[joint].any()
        child = names["body", body] if centred else f"{names['joint', joint]}_moved"
        if not centred:
            urdf_link(robot, child)
        made = urdf_joint(
            robot, names["joint", joint], _kind(model, joint), on, child, at @ anchor @ _unturned(model, joint)
        )
        if made.get("type") != "floating":
            ElementTree.SubElement(made, "axis", xyz=figures_text(model.jnt_axis[joint]))
        if model.jnt_limited[joint]:
            low, high = (repr(float(limit)) for limit in model.jnt_range[joint])
            ElementTree.SubElement(made, "limit", lower=low, upper=high, effort="0", velocity="0")
        if centred:
            return
        at, on = np.linalg.inv(anchor), child
    urdf_joint(robot, f"{names['body', body]}-fixed", "fixed", on, names["body", body], at)


def _kind(model: Any, joint: int) -> str:
    """A joint's type in URDF: what turns freely about a point or moves anywhere is floating there."""
    import mujoco

    limited = bool(model.jnt_limited[joint])
    kinds = {
        mujoco.mjtJoint.mjJNT_HINGE: "revolute" if limited else "continuous",
        mujoco.mjtJoint.mjJNT_SLIDE: "prismatic",
    }
    return kinds.get(mujoco.mjtJoint(model.jnt_type[joint]), "floating")


def _unturned(model: Any, joint: int) -> np.ndarray:
    """What leads a joint from where it is drawn, at its `ref`, to its zero (4, 4)."""
    kind = _kind(model, joint)
    ref, axis = float(model.qpos0[model.jnt_qposadr[joint]]), model.jnt_axis[joint]
    if kind == "floating" or not ref:
        return np.eye(4)
    if kind == "prismatic":
        return shift(-ref * axis)
    return _transform(np.zeros(3), np.r_[np.cos(-ref / 2), np.sin(-ref / 2) * axis])


def _followers(model: Any) -> Iterator[tuple[int, int, float, float]]:
    """Joints that an equality ties to another's, linearly: follower, leader, multiplier and offset."""
    import mujoco

    for k in range(model.neq):
        follower, leader = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        tied = model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT and leader >= 0 and model.eq_active0[k]
        if tied and not model.eq_data[k][2:5].any():
            start, slope = (float(value) for value in model.eq_data[k][:2])
            zero = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (follower, leader)]
            yield follower, leader, slope, zero[0] + start - slope * zero[1]


def _transform(pos: np.ndarray, quat: np.ndarray) -> np.ndarray:
    at = shift(pos)
    at[:3, :3] = Rotation.from_quat(quat, scalar_first=True).as_matrix()
    return at
