"""A foundation that tilts under an arm whose masses nobody knows, against the simulator's that knows them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calflow.effects.base_tilt import BaseTilt
from calflow.files.toml import Origin
from calflow.model import Model
from calflow.robot.formats.robot_file import parts_of
from calflow.robot.robot import Robot
from hidden.case import Case, draw, robot_file, stated_tables
from hidden.causes import PAYLOADS, Hidden, measured_points
from robots import rows

POSITIONS = SimpleNamespace(in_images=False)
SOFTER = Hidden("base-compliance", 0, 2e-8, 0.3)


@pytest.fixture(scope="module")
def serial() -> Robot:
    """The robot whose links' masses nobody knows."""
    return Robot(**parts_of(robot_file(stated_tables(Case()), masses=False), Origin(Path(), (), {})))


@pytest.fixture(scope="module")
def moved() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joints (rows, 6), payloads, and by how much a stiff arm's foundation moves the tool."""
    world = draw(Case(poses=240), np.random.default_rng(3))
    stiff = replace(world.stated, compliance=0 * world.stated.compliance)
    shift = measured_points(stiff, world.rows, (SOFTER,)) - measured_points(stiff, world.rows, ())
    return world.rows.q, world.rows.payload, shift


def left(robot: Robot, shape: str, moved: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    """Share of the shift, at poses that were not fitted, that an effect cannot follow beside a robot placed elsewhere."""
    q, payload, shift = moved
    model = Model(robot, (BaseTilt(robot, shape),))
    packed = np.concatenate([rows(model, q[[i]], PAYLOADS[k], "E") for i, k in enumerate(payload)], axis=1)
    zero = np.zeros(len(model.parameters))
    slope = model.position_jacobian(zero, packed) * model.prior_sd
    placed = np.tile(np.eye(3), (len(q), 1, 1))
    arm = model.position(zero, packed)
    turned = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2)
    whole = np.concatenate([slope, placed, turned], axis=2)
    fitted = np.arange(len(q)) % 3 > 0
    found = np.linalg.lstsq(whole[fitted].reshape(-1, whole.shape[2]), shift[fitted].ravel(), rcond=1e-9)[0]
    rest, own = (whole @ found - shift)[~fitted], shift[~fitted]
    return float(np.sqrt((rest**2).sum() / ((own - own.mean(axis=0)) ** 2).sum()))


def test_first_moments_stand_for_masses(serial, moved):
    """Breaks if moments of each link and of the payload leave a part of a foundation's tilt that is softer in one direction."""
    assert left(serial, "moments", moved) < 0.01


def test_a_rule_of_masses_follows_a_real_arms_moment(serial, moved):
    """Breaks if the rule's moments go otherwise than a real arm's, or a direction alone is followed by none."""
    assert left(serial, "direction", moved) < 0.15
    assert left(serial, "alike", moved) > 2 * left(serial, "direction", moved)


def test_payloads_of_unknown_mass_tilt_the_base_too(serial, moved):
    """Fails if the moment arm of a load that nobody weighed is left out, or loads of different weight share a compliance."""
    unknown = replace(
        serial, payloads={name: replace(load, mass=load.mass and None) for name, load in serial.payloads.items()}
    )
    assert left(unknown, "moments", moved) < 0.03
    assert left(unknown, "direction", moved) < 0.2


def test_known_masses_make_it_needless(serial):
    """Fails if a foundation is looked for twice."""
    known = Robot(**parts_of(robot_file(stated_tables(Case()), masses=True), Origin(Path(), (), {})))
    assert BaseTilt.superseded(known, POSITIONS)
    assert BaseTilt.superseded(serial, POSITIONS) == ""
    unloaded = replace(serial, payloads={})
    assert [parameter.symbol for parameter in BaseTilt(unloaded, "direction").declared] == ["tx", "ty", "txy"]
