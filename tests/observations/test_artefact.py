"""Artefact: known points of a plate or a ladder that lies anywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.design.candidates import candidates
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations.artefact import Artefact
from calflow.robot.parts import Base
from hidden.devices import Arm, measured, rows
from hidden.trials import calibrated, error_of_tool
from observations.graph import error, frame, no_links, through_json
from robots import ur10

PLACE = np.array([0.5, 0.3, 0.2, 0.2, -0.3, 0.6])
PLATE = np.array([(x, y, 0.0) for x in (0.0, 0.2, 0.4) for y in (0.0, 0.15, 0.3)])
LADDER = np.array([(x, 0.0, 0.0) for x in (0.0, 0.1, 0.25, 0.5)])


def lying(own: np.ndarray, place: np.ndarray = PLACE) -> np.ndarray:
    """Where the points of an artefact are."""
    turn, origin = frame(place)
    return origin + own @ turn.T


def stated(own: np.ndarray, **more: object) -> pd.DataFrame:
    """Rows of these points."""
    return pd.DataFrame(own, columns=["px_x", "px_y", "px_z"]).assign(**more)


def test_the_error_is_the_markers_place_less_the_points():
    """Fails if the scale, the place's errors or their axes are wrong."""
    rng = np.random.default_rng(1)
    points, table = rng.normal(size=(9, 3)), stated(PLATE)
    plate = replace(Artefact.of(Series.of("", "artefact", {"scale_sd": 1e-5}), table), nominal=(tuple(PLACE),))
    p = 0.1 * rng.normal(size=7)
    turn, shift = frame(p[:6])
    there = lying(shift + (1 + p[6]) * PLATE @ turn.T)
    np.testing.assert_allclose(error(plate, p, points, table), points - there, atol=1e-12)
    assert [q.name for q in plate.declared][-2:] == ["artefact.rz", "artefact.scale"]


@pytest.mark.parametrize("own", [PLATE, LADDER])
def test_an_artefact_is_laid_where_its_points_are(own):
    """Fails if exact points leave an error: of a plate, or of points in a line, mirrored ones too."""
    table = stated(own)
    laid = Artefact.of(Series("", "artefact"), table).registered(lying(own), no_links, table)
    np.testing.assert_allclose(error(laid, np.zeros(6), lying(own), table), 0, atol=1e-12)
    assert through_json(laid) == laid


def test_a_new_placement_is_lacking_until_it_is_added():
    """Fails if an unknown placement goes unseen, or adding it moves the one that is known."""
    known, new = (stated(PLATE, placement=name) for name in "ab")
    laid = Artefact.of(Series("", "artefact"), known).registered(lying(PLATE), no_links, known)
    assert laid.lacks(new)
    wider = laid.extended(new)
    assert wider.placements | laid.placements == wider.placements
    assert not wider.lacks(new)


def test_planned_poses_touch_the_corners_of_the_artefact_that_is_stated():
    """Fails if candidates miss its corners, or one of unknown place is planned for."""
    settings = {"origin": tuple(PLACE[:3]), "rotation": tuple(PLACE[3:]), "size": (0.4, 0.3)}
    plate = Artefact.planned(Series.of("plate", "artefact", settings))
    model = build(replace(ur10(), base=Base(fixed=True)), ("geometry",), (), (plate,))
    readings, conditions = candidates(model, 20, "", "E", None, np.random.default_rng(1), plate)
    assert len(readings) == 20
    corners = lying(np.array([(x, y, 0.0) for x in (0.0, 0.4) for y in (0.0, 0.3)]))
    apart = np.linalg.norm(model.point(model.nominal, conditions)[:, None] - corners, axis=2).min(axis=1)
    assert apart.max() < 2e-6
    with pytest.raises(ValueError, match="size_mm"):
        Artefact.planned(Series("plate", "artefact"))


def test_touches_of_a_plate_in_two_places_calibrate_a_robot():
    """Fails if a plate of known points biases the fit, or it promises too much: its lengths tell the robot's."""
    rng = np.random.default_rng(4)
    arm = Arm.drawn(ur10(), rng)
    places = {"front": PLACE, "side": np.array([-0.5, 0.4, 0.3, 0.0, 0.5, 1.0])}
    every = [
        rows(q).assign(placement=name, **dict(zip(("px_x", "px_y", "px_z"), own, strict=True)))
        for name, place in places.items()
        for own in PLATE
        for q in [arm.touching(lying(own[None], place)[0], 8, rng, 5e-5)]
    ]
    table = pd.concat(every, ignore_index=True)
    found = calibrated(measured(arm.robot, table, Series("plate", "artefact"), 5e-5), ("geometry",)).fit
    squared = float((found.residual**2).sum()) / (found.residual.size - found.effective_parameters)
    assert 0.6 < squared < 1.5
    tool = error_of_tool(found, arm, 300, rng)
    assert tool.true < 1.5 * tool.promised
