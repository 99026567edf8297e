"""Datum cube: touches of faces that are square to each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.design.candidates import candidates
from calflow.files.problems import InputError
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations.datum_cube import DatumCube
from calflow.robot.parts import Base
from observations.graph import error, frame, no_links, through_json
from robots import ur10

PLACE, SIZE = np.array([0.5, 0.3, 0.2, 0.2, -0.3, 0.6]), np.array([0.1, 0.15, 0.2])
STATED = Series.of("block", "datum-cube", {"size": tuple(SIZE)})


def on_faces(rng: np.random.Generator, faces: list[str], place: np.ndarray = PLACE) -> np.ndarray:
    """A point on each of these faces."""
    turn, origin = frame(place)
    own = -rng.uniform(0.1, 0.9, (len(faces), 3)) * SIZE
    for point, face in zip(own, faces, strict=True):
        k = "xyz".index(face[-1])
        point[k] = -SIZE[k] if face[0] == "-" else 0.0
    return origin + own @ turn.T


def test_the_error_is_the_height_over_the_face_less_the_reading():
    """Fails if a face looks another way, its opposite is not as far away as the cube is large, or readings have another sign."""
    rng = np.random.default_rng(1)
    faces = ["x", "y", "z", "-x", "-y", "-z"]
    points, reading = rng.normal(size=(6, 3)), rng.normal(size=6)
    table = pd.DataFrame({"face": faces, "reading": reading})
    cube = replace(DatumCube.of(STATED, table), nominal=(tuple(PLACE),))
    turn, origin = frame(PLACE)
    own = (points - origin) @ turn
    heights = np.append(own[[0, 1, 2], [0, 1, 2]], -own[[3, 4, 5], [0, 1, 2]] - SIZE)
    np.testing.assert_allclose(error(cube, np.zeros(6), points, table)[:, 0], heights - reading, atol=1e-12)


@pytest.mark.parametrize("faces", [["x", "y", "z"], ["x", "-x", "y", "z"], ["y", "z"], ["-x", "-y", "z"]])
def test_a_cube_is_laid_against_its_faces(faces):
    """Fails if exact points leave an error: an axis with the wrong sense, or faces that are not square."""
    rng = np.random.default_rng(2)
    named = faces * 6
    points, table = on_faces(rng, named), pd.DataFrame({"face": named})
    cube = DatumCube.of(STATED, table).registered(points, no_links, table)
    np.testing.assert_allclose(error(cube, np.zeros(6), points, table), 0, atol=1e-7)
    assert through_json(cube) == cube


def test_a_new_cube_is_lacking_until_it_is_added():
    """Fails if an unknown cube goes unseen, or adding it moves the one that is known."""
    rng = np.random.default_rng(3)
    named = ["x", "y", "z"] * 4
    points = on_faces(rng, named)
    known, new = (pd.DataFrame({"face": named, "cube": [name] * 12}) for name in "ab")
    cube = DatumCube.of(STATED, known).registered(points, no_links, known)
    assert cube.lacks(new)
    wider = cube.extended(new)
    assert wider.placements | cube.placements == wider.placements
    assert not wider.lacks(new)
    assert cube == DatumCube.of(STATED, known).placed(cube.placements)


def test_faces_that_no_cube_has_are_refused():
    """Fails if a misspelt face goes through, or one opposite another of a cube of unknown size."""
    with pytest.raises(InputError, match="'top'"):
        DatumCube.of(STATED, pd.DataFrame({"face": ["x", "top"]}))
    with pytest.raises(InputError, match="size_mm"):
        DatumCube.of(Series("", "datum-cube"), pd.DataFrame({"face": ["x", "-x"]}))


def test_planned_poses_touch_the_faces_that_are_stated():
    """Fails if candidates miss the faces, or a cube of unknown place is planned for."""
    turned = {"size": tuple(SIZE), "origin": tuple(PLACE[:3]), "rotation": tuple(PLACE[3:])}
    cube = DatumCube.planned(Series.of("block", "datum-cube", turned))
    model = build(replace(ur10(), base=Base(fixed=True)), ("geometry",), (), (cube,))
    readings, conditions = candidates(model, 30, "", "E", None, np.random.default_rng(1), cube)
    assert len(readings) == 30
    turn, origin = frame(PLACE)
    own = (model.point(model.nominal, conditions) - origin) @ turn
    assert np.abs(own).min(axis=1).max() < 2e-6
    with pytest.raises(ValueError, match="origin_mm"):
        DatumCube.planned(STATED)
