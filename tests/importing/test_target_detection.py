"""Targets in images that are rendered here: warped, blurred and noisy, with their points known; and in photographs."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calflow.files.problems import InputError
from calflow.importing.target_detection import detect_targets
from conftest import in_process

cv2 = pytest.importorskip("cv2")
SHAPE = (900, 1200)  # px
SCALE = 4.0  # px a millimetre of the flat picture
MARGIN = 100.0  # px about it
FINER = 4  # times: an image is rendered so much larger, so that edges fall between pixels
SQUARES = {"columns": 8, "rows": 5, "size_mm": 30}


def written(folder: Path, **said: object) -> Path:
    """A target's file."""
    lines = [
        f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {str(value).lower()}"
        for key, value in said.items()
    ]
    path = folder / "board.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def flat_picture(said: dict) -> np.ndarray:
    """The target from the front, its origin at MARGIN, SCALE px a millimetre."""
    columns, rows = said["columns"], said["rows"]
    if said["kind"] in ("charuco", "markers"):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, said["dictionary"]))
        if said["kind"] == "charuco":
            board = cv2.aruco.CharucoBoard((columns, rows), said["size_mm"], said["marker_mm"], dictionary)
            width, height = columns * said["size_mm"], rows * said["size_mm"]
        else:
            board = cv2.aruco.GridBoard((columns, rows), said["marker_mm"], said["gap_mm"], dictionary)
            width, height = (n * said["marker_mm"] + (n - 1) * said["gap_mm"] for n in (columns, rows))
        drawn = board.generateImage((round(SCALE * width), round(SCALE * height)), marginSize=0)
        return cv2.copyMakeBorder(drawn, *[int(MARGIN)] * 4, cv2.BORDER_CONSTANT, value=255)
    step = SCALE * said["size_mm"]
    if said["kind"] == "checkerboard":
        j, i = np.indices((rows, columns))
        squares = np.where((i + j) % 2, 255, 0).astype(np.uint8)
        return cv2.copyMakeBorder(
            np.kron(squares, np.ones((int(step), int(step)), np.uint8)),
            *[int(MARGIN)] * 4,
            cv2.BORDER_CONSTANT,
            value=255,
        )
    picture = np.full((int(2 * MARGIN + step * (rows - 1)), int(2 * MARGIN + step * (columns - 1))), 255, np.uint8)
    for j in range(rows):
        for i in range(columns):
            size = 0.45 if said.get("large_circle") and i == j == 0 else 0.25
            cv2.circle(
                picture, (round(MARGIN + i * step), round(MARGIN + j * step)), round(size * step), 0, -1, cv2.LINE_AA
            )
    return picture


def rendered(flat: np.ndarray, turned: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A picture seen from aside, turned in the image [rad], blurred and noisy; and the homography (3, 3) that leads to it."""
    height, width = flat.shape
    middle = np.array([width, height]) / 2
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], float)
    turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    size = 0.62 * min(SHAPE) / max(width, height)
    there = size * (corners - middle) @ turn.T * (1.0, 0.8) + np.array(SHAPE[::-1]) / 2
    there += rng.uniform(-35, 35, (4, 2))
    homography = cv2.getPerspectiveTransform(corners.astype(np.float32), there.astype(np.float32))
    finer = np.array([[FINER, 0, (FINER - 1) / 2], [0, FINER, (FINER - 1) / 2], [0, 0, 1]])
    large = cv2.warpPerspective(flat, finer @ homography, (FINER * SHAPE[1], FINER * SHAPE[0]), borderValue=150)
    image = cv2.resize(large, SHAPE[::-1], interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.9) * 0.7 + 30
    return np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8), homography


KINDS = {
    "charuco": {"kind": "charuco", **SQUARES, "marker_mm": 22, "dictionary": "DICT_5X5_100"},
    "apriltags": {
        "kind": "markers",
        "columns": 5,
        "rows": 4,
        "marker_mm": 40,
        "gap_mm": 10,
        "dictionary": "DICT_APRILTAG_36h11",
    },
    "checkerboard": {"kind": "checkerboard", **SQUARES},
    "circles": {"kind": "circles", **SQUARES, "large_circle": True},
    "a square of circles": {"kind": "circles", "columns": 7, "rows": 7, "size_mm": 25, "large_circle": True},
}

PHOTOGRAPHED = {
    "charuco": {
        "kind": "charuco",
        "columns": 5,
        "rows": 7,
        "size_mm": 36.195,
        "marker_mm": 18.256,
        "dictionary": "DICT_6X6_250",
    },
    "10x10": {"kind": "circles", "columns": 10, "rows": 10, "size_mm": 25.4, "large_circle": True},
}


@pytest.mark.parametrize("name", KINDS)
def test_points_are_found_to_parts_of_a_pixel(name, tmp_path):
    """Fails if points are mistaken for others, counted from another corner, or off by more than parts of a pixel."""
    said = KINDS[name]
    flat, rng = flat_picture(said), np.random.default_rng(3)
    homographies = {}
    for k, turned in enumerate((0.5, 1.9, -2.2)):
        image, homographies[f"{k}.png"] = rendered(flat, turned, rng)
        cv2.imwrite(str(tmp_path / f"{k}.png"), image)
    found = detect_targets([tmp_path / name for name in homographies], written(tmp_path, **said))
    assert not found.left_out
    zero = MARGIN + (SCALE * said["size_mm"] if said["kind"] == "checkerboard" else 0.0)
    # a drawn square begins at the edge of a pixel, a circle has its middle on one
    edge = 0.0 if said["kind"] == "circles" else -0.5
    for name_of, own in found.table.groupby("image"):
        points = zero + SCALE * own[["px_x_mm", "px_y_mm"]].to_numpy() + edge
        there = cv2.perspectiveTransform(points[None].astype(float), homographies[name_of])[0]
        off = np.linalg.norm(own[["u_px", "v_px"]].to_numpy() - there, axis=1)
        assert off.mean() < (
            0.4 if said["kind"] == "markers" else 0.2
        )  # corners of markers are round in print and blur
        assert off.max() < 1.0
    assert set(found.pictures) == set(homographies)


def test_why_an_image_is_left_out_is_said(tmp_path):
    """Fails if an image without the target, of another size, that is none or that is not there ends anything, or goes unsaid."""
    said = KINDS["charuco"]
    image, _ = rendered(flat_picture(said), 0.3, np.random.default_rng(4))
    cv2.imwrite(str(tmp_path / "good.png"), image)
    cv2.imwrite(str(tmp_path / "grey.png"), np.full(SHAPE, 120, np.uint8))
    cv2.imwrite(str(tmp_path / "small.png"), image[:500])
    (tmp_path / "text.png").write_text("no image", encoding="utf-8")
    board = written(tmp_path, **said)
    joints = tmp_path / "joints.csv"
    joints.write_text("image,q1_deg,q2_deg\ngood.png,1,2\nlost.png,3,4\n", encoding="utf-8")
    names = [tmp_path / f"{name}.png" for name in ("good", "grey", "small", "text", "gone")]
    answer = in_process("detect", *names, "--target", board, "--joints", joints, "--into", tmp_path / "study")
    assert answer.code == 0, answer
    assert "the readings of lost.png belong to no image" in answer.out + answer.err
    left_out = pd.read_csv(tmp_path / "study" / "detections" / "left_out.csv").set_index("image")["reason"]
    assert left_out["grey.png"].startswith("0 corners found")
    assert "of another lens" in left_out["small.png"]
    turned = written(tmp_path, **(said | {"columns": said["rows"], "rows": said["columns"]}))
    answer = in_process("detect", tmp_path / "good.png", "--target", turned, "--into", tmp_path / "other")
    assert "are columns and rows exchanged" in answer.err
    other = written(tmp_path, **(said | {"dictionary": "DICT_4X4_250"}))
    answer = in_process("detect", tmp_path / "good.png", "--target", other, "--into", tmp_path / "other")
    assert f"markers of {said['dictionary'].rsplit('_', 1)[0]}_" in answer.err
    joints.write_text("image,q1_deg\nimg_1.png,1\nimg_2.png,3\n", encoding="utf-8")
    answer = in_process(
        "detect", tmp_path / "good.png", "--target", board, "--joints", joints, "--into", tmp_path / "other"
    )
    assert "joints.csv" in answer.err
    assert "names none of the images: expected good.png, found img_1.png and img_2.png" in answer.err
    assert left_out[["text.png", "gone.png"]].tolist() == ["cannot be read as an image", "is not there"]
    rows = pd.read_csv(tmp_path / "study" / "measurements.csv")
    assert (rows["q2_deg"] == 2).all()
    assert (tmp_path / "study" / "detections" / "good.png.png").stat().st_size > 1000
    assert in_process("detect", *names, "--target", board, "--into", tmp_path / "study").code == 2


def test_markers_are_no_circles(tmp_path):
    """Fails if the squares of markers pass for a plain grid of circles, whose size and points are then nonsense."""
    image, _ = rendered(flat_picture(KINDS["apriltags"]), 0.5, np.random.default_rng(3))
    cv2.imwrite(str(tmp_path / "tags.png"), image)
    circles = written(tmp_path, kind="circles", columns=4, rows=3, size_mm=50)
    found = detect_targets([tmp_path / "tags.png"], circles)
    assert not len(found.table)
    assert "markers, as of DICT_APRILTAG_36h11, where circles should be" in found.left_out["tags.png"]


def test_pictures_and_standstills_that_are_there_twice_and_other_boards_are_said(tmp_path):
    """Fails if a copied picture or one of two boards alike is taken, another board goes unsaid, or a standstill is two poses."""
    said, rng = KINDS["charuco"], np.random.default_rng(5)
    first, second, third = (rendered(flat_picture(said), turned, rng)[0] for turned in (0.3, 0.1, -0.4))
    pair = np.full(SHAPE, 150, np.uint8)
    pair[: SHAPE[0] // 2] = cv2.resize(np.hstack([first, second]), (SHAPE[1], SHAPE[0] // 2))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    others = cv2.aruco.GridBoard((6, 1), 40.0, 10.0, dictionary, np.arange(60, 66)).generateImage((900, 160))
    third[720:880, 150:1050] = others
    pictures = {"first": first, "second": second, "third": third, "copy": first, "pair": pair}
    for name, picture in pictures.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture)
    joints = tmp_path / "joints.csv"
    joints.write_text("image,q1_deg,q2_deg\nfirst.png,1,2\nsecond.png,3,4\nthird.png,1,2\n", encoding="utf-8")
    names = [tmp_path / f"{name}.png" for name in pictures]
    board = written(tmp_path, **said)
    answer = in_process("detect", *names, "--target", board, "--joints", joints, "--into", tmp_path / "study")
    assert answer.code == 0, answer
    left_out = pd.read_csv(tmp_path / "study" / "detections" / "left_out.csv").set_index("image")["reason"]
    assert left_out["copy.png"] == "is the same picture as first.png"
    assert "two boards alike" in left_out["pair.png"]
    assert "not this target's are in third.png:" in answer.out + answer.err
    images = pd.read_csv(tmp_path / "study" / "measurements.csv").drop_duplicates("image").set_index("image")
    assert images["pose"].to_dict() == {"first.png": 1, "second.png": 2, "third.png": 1}
    assert images["repeat"].to_dict() == {"first.png": 1, "second.png": 1, "third.png": 2}


def test_images_that_differ_by_their_ending_alone_have_a_picture_each(tmp_path):
    """Fails if what was found in 1.png is drawn over what was found in 1.bmp."""
    said, rng = KINDS["charuco"], np.random.default_rng(6)
    names = [tmp_path / f"1.{ending}" for ending in ("bmp", "png")]
    for name, turned in zip(names, (0.3, 0.1), strict=True):
        cv2.imwrite(str(name), rendered(flat_picture(said), turned, rng)[0])
    answer = in_process("detect", *names, "--target", written(tmp_path, **said), "--into", tmp_path / "study")
    assert answer.code == 0, answer
    drawn = sorted(path.name for path in (tmp_path / "study" / "detections").glob("*.png"))
    assert drawn == ["1.bmp.png", "1.png.png"]


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("image,x_m,y_m\na.png,1,2\n", "expected joint readings, q1_deg"),
        ("image,q1,q2\na.png,1,2\n", "expected joint readings, q1_deg"),
        ("image,q1_deg,q2_deg\na.png,1,\n", "joints.csv:2: a.png: expected a number"),
        ("image,q1_deg,q2_deg\na.png,1,2\na.png,1,3\n", "joints.csv:3: a.png: has other joint readings in line 2"),
    ],
)
def test_readings_that_are_none_are_refused(tmp_path, table, told):
    """Fails if poses of the flange, readings without a unit or gaps go into the measurements, to be found out later or never."""
    cv2.imwrite(str(tmp_path / "a.png"), np.full(SHAPE, 120, np.uint8))
    joints = tmp_path / "joints.csv"
    joints.write_text(table, encoding="utf-8")
    board = written(tmp_path, **KINDS["charuco"])
    answer = in_process(
        "detect", tmp_path / "a.png", "--target", board, "--joints", joints, "--into", tmp_path / "study"
    )
    assert answer.code == 2
    assert told in answer.err


def test_a_target_that_cannot_be_is_refused(tmp_path):
    """Fails if sizes that are missing, or a dictionary that there is not, are found out by a traceback."""
    with pytest.raises(InputError, match="marker_mm less than size_mm"):
        detect_targets([], written(tmp_path, **KINDS["charuco"] | {"marker_mm": 40}))
    with pytest.raises(InputError, match="needs marker_mm, dictionary"):
        detect_targets([], written(tmp_path, kind="charuco", columns=5, rows=4, size_mm=30))
    with pytest.raises(InputError, match="DICT_6X6_250"):
        detect_targets([], written(tmp_path, **KINDS["charuco"] | {"dictionary": "DICT_6X6_25"}))
    with pytest.raises(InputError, match=r"(?s)DICT_6X6_250.*colour: unknown key"):
        detect_targets([], written(tmp_path, **KINDS["charuco"] | {"dictionary": "DICT_6X6_25", "colour": 1}))


@pytest.mark.skipif("CALFLOW_DATA" not in os.environ, reason="CALFLOW_DATA names no folder of measured data")
@pytest.mark.parametrize(("folder", "points"), [("charuco", 280), ("10x10", 1500)])
def test_photographs_of_targets(folder, points, tmp_path):
    """Fails if a photograph shows its target in vain."""
    images = [one for one in (Path(os.environ["CALFLOW_DATA"]) / "hand-eye" / folder).iterdir() if one.suffix != ".csv"]
    found = detect_targets(sorted(images), written(tmp_path, **PHOTOGRAPHED[folder]))
    assert not found.left_out
    assert len(found.table) >= points
