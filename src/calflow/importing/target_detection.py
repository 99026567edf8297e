"""Detection of the points of a printed calibration target in images, with subpixel accuracy, by OpenCV.

Targets are ChArUco boards, grids of ArUco markers or AprilTags, checkerboards and grids of circles. The target frame
has x across its columns, y down its rows, z away from the viewer; pixel coordinates start at the first pixel's centre.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from calflow.files.deferred import pd
from calflow.files.problems import escaped, nearest, refuse
from calflow.files.toml import FileModel, Length, read_toml
from calflow.files.words import plural

FEWEST_IMAGE_POINTS = 4  # least number of points that determine the target's pose
DARKER = 10  # least difference in grey level between a white and a black square
LARGER = 1.25  # least diameter of the circle at the origin relative to the others
PICTURE = 1600  # px: longest side of a picture that shows the detected points
PLACES = 4  # decimals of a point's coordinates [mm]


class TargetFile(FileModel):
    """The specification of a printed target: its kind, the number of its squares, markers or circles, and their sizes.

    columns and rows count squares (charuco, checkerboard), markers or circles. size is a square's side, or the distance
    between centres of adjacent circles; marker is a marker's side, gap the distance between two. large_circle: a larger
    circle in a corner marks the origin. legacy: ChArUco pattern of OpenCV before 4.6, which begins with a marker.
    """

    kind: Literal["charuco", "checkerboard", "circles", "markers"]
    columns: int = Field(ge=2, le=200)
    rows: int = Field(ge=2, le=200)
    size: Length | None = Field(default=None, gt=0)
    marker: Length | None = Field(default=None, gt=0)
    gap: Length | None = Field(default=None, gt=0)
    dictionary: str = ""
    legacy: bool = False
    large_circle: bool = False

    @field_validator("dictionary")
    @classmethod
    def _is_one_of_opencvs(cls, name: str) -> str:
        names = _dictionaries(_opencv())
        if name and name not in names:
            raise ValueError(f"expected one of OpenCV's, such as DICT_6X6_250, found '{name}'{nearest(name, names)}")
        return name

    @model_validator(mode="after")
    def _is_whole(self) -> TargetFile:
        needs = {"charuco": ("size", "marker", "dictionary"), "markers": ("marker", "gap", "dictionary")}
        lacking = [name for name in needs.get(self.kind, ("size",)) if not getattr(self, name)]
        if lacking:
            keys = [name if name == "dictionary" else f"{name}_mm" for name in lacking]
            raise ValueError(f'kind = "{self.kind}" needs {", ".join(keys)}, as printed')
        if self.kind == "charuco" and (self.marker or 0.0) >= (self.size or 0.0):
            raise ValueError("a marker is inside a square of the board: expected marker_mm less than size_mm")
        return self

    @property
    def is_turned_unseen(self) -> bool:
        """Whether the target is symmetric under a half turn, so that points may be numbered from either end."""
        same_colours = self.kind == "checkerboard" and (self.columns + self.rows) % 2 == 0
        return same_colours or (self.kind == "circles" and not self.large_circle)


@dataclass(frozen=True, eq=False)
class Detected:
    """Points of a target detected in an image: names (n,), coordinates in target (n, 3) [m] and image (n, 2) [px].

    foreign says whether the image also shows markers that do not belong to the target.
    """

    names: np.ndarray
    points: np.ndarray
    image: np.ndarray
    foreign: bool = False


@dataclass(frozen=True, eq=False)
class Detections:
    """Detections in images: a table with a row per point, PNG pictures by image name, and why images were left out."""

    table: pd.DataFrame
    pictures: dict[str, bytes]
    left_out: dict[str, str]
    notes: tuple[str, ...]


def detect_targets(images: Sequence[Path], target: Path) -> Detections:
    """Return the detections of a target, specified by a TOML file, in images.

    Raises:
        InputError: OpenCV is not installed, or the target file is invalid.
    """
    cv2 = _opencv()
    printed = read_toml(target, TargetFile)
    find = _finder(cv2, printed)
    tables, pictures, left_out = list[pd.DataFrame](), dict[str, bytes](), dict[str, str]()
    size: tuple[int, ...] = ()
    first, beside_others = dict[bytes, str](), list[str]()
    for number, path in enumerate(images, start=1):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            left_out[path.name] = "cannot be read as an image" if path.exists() else "is not there"
            continue
        if size and grey.shape != size:
            left_out[path.name] = (
                f"is {grey.shape[1]} x {grey.shape[0]} px, the others are {size[1]} x {size[0]}: of another lens"
            )
            continue
        if (same := first.setdefault(grey.tobytes(), path.name)) != path.name:
            left_out[path.name] = f"is the same picture as {escaped(same)}"
            continue
        detected = find(grey)
        if isinstance(detected, str):
            if printed.dictionary and not tables and not left_out:
                detected += _of_another(cv2, printed.dictionary, grey)
            left_out[path.name] = detected
            continue
        size = grey.shape
        beside_others += [path.name] if detected.foreign else []
        tables.append(_rows(detected, number, path.name))
        pictures[path.name] = _picture(cv2, grey, detected)
    columns = ["image", "pose", "point", "px_x_mm", "px_y_mm", "px_z_mm", "u_px", "v_px"]
    table = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=columns)
    notes = [f"size_px = [{size[1]}, {size[0]}]"] if size else []
    if printed.is_turned_unseen:
        notes.append(
            "this target looks the same upside down: images taken from the other side are counted from the other end"
        )
    if beside_others:
        more = f" and {len(beside_others) - 1} more" if len(beside_others) > 1 else ""
        notes.append(
            f"markers that are not this target's are in {escaped(beside_others[0])}{more}: another board, if it is one, is "
            "detected by its own --target, into a folder of its own"
        )
    return Detections(table, pictures, left_out, tuple(notes))


def _opencv() -> Any:
    try:
        import cv2
    except ImportError:
        raise refuse(
            "images are read by OpenCV, which the extra 'camera' brings: pip install calflow[camera]"
        ) from None
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # unreadable images are reported by name
    return cv2


def _dictionaries(cv2: Any) -> list[str]:
    """The names of all dictionaries of markers, those of few markers before the larger ones that contain them."""
    every = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
    return sorted(every, key=lambda name: len(_dictionary(cv2, name).bytesList))


def _dictionary(cv2: Any, name: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _of_another(cv2: Any, dictionary: str, grey: np.ndarray) -> str:
    """The message that an image shows markers of another dictionary than stated, or an empty string."""
    read = {
        name: len(_numbers(cv2.aruco.ArucoDetector(_dictionary(cv2, name)).detectMarkers(grey)[1]))
        for name in _dictionaries(cv2)
    }
    likeliest = max(read, key=lambda name: read[name])
    more = read[likeliest] >= FEWEST_IMAGE_POINTS + read[dictionary]
    return f"; it shows {read[likeliest]} markers of {likeliest}" if more else ""


def _rows(detected: Detected, number: int, name: str) -> pd.DataFrame:
    places = {f"px_{axis}_mm": np.round(1e3 * detected.points[:, k], PLACES) for k, axis in enumerate("xyz")}
    image = {"u_px": np.round(detected.image[:, 0], 4), "v_px": np.round(detected.image[:, 1], 4)}
    return pd.DataFrame({"image": name, "pose": number, "point": detected.names, **places, **image})


def _picture(cv2: Any, grey: np.ndarray, detected: Detected) -> bytes:
    """The image as PNG with the detected points drawn in, the first one larger."""
    scale = min(1.0, PICTURE / max(grey.shape))
    small = cv2.resize(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for k, (u, v) in enumerate(scale * detected.image):
        centre = (round(float(u)), round(float(v)))
        cv2.circle(small, centre, 9 if k == 0 else 4, (0, 0, 255) if k == 0 else (0, 180, 0), 1, cv2.LINE_AA)
    return bytes(cv2.imencode(".png", small)[1])


def _finder(cv2: Any, printed: TargetFile) -> Any:
    """The function that returns the `Detected` points of a grey image, or the reason why there are none."""
    if printed.kind == "checkerboard":
        return lambda grey: _checkerboard(cv2, printed, grey)
    if printed.kind == "circles":
        return lambda grey: _circles(cv2, printed, grey)
    dictionary = _dictionary(cv2, printed.dictionary)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    shape = (printed.columns, printed.rows)
    if printed.kind == "charuco":
        board = cv2.aruco.CharucoBoard(shape, printed.size, printed.marker, dictionary)
        board.setLegacyPattern(printed.legacy)
        detector = cv2.aruco.CharucoDetector(board, cv2.aruco.CharucoParameters(), parameters)
        return lambda grey: _charuco(board, detector, grey)
    board = cv2.aruco.GridBoard(shape, printed.marker, printed.gap, dictionary)
    plain = cv2.aruco.ArucoDetector(dictionary, parameters)
    return lambda grey: _markers(board, plain, grey)


def _charuco(board: Any, detector: Any, grey: np.ndarray) -> Detected | str:
    corners, names, _, seen = detector.detectBoard(grey)
    numbers, markers = _numbers(names), _numbers(seen)
    if twice := _shown_twice(markers):
        return twice
    found, read = len(numbers), len(markers)
    if found < FEWEST_IMAGE_POINTS:
        exchanged = not found and read > FEWEST_IMAGE_POINTS
        wrong = "; are columns and rows exchanged, are they others, or is legacy wrong?" if exchanged else ""
        return (
            f"{plural(found, 'corner')} found, {FEWEST_IMAGE_POINTS} are needed ({plural(read, 'marker')} read{wrong})"
        )
    places = np.asarray(board.getChessboardCorners(), float)[numbers]
    return Detected(numbers, places, np.asarray(corners, float).reshape(-1, 2), _has_foreign(markers, board))


def _numbers(markers: np.ndarray | None) -> np.ndarray:
    """The numbers of detected markers (n,), of which OpenCV says None if there are none."""
    return np.empty(0, int) if markers is None else np.ravel(markers)


def _shown_twice(markers: np.ndarray) -> str:
    """The message that an image shows two identical boards, or an empty string."""
    every, times = np.unique(markers, return_counts=True)
    twice = every[times > 1]
    if len(twice) < FEWEST_IMAGE_POINTS:
        return ""
    return f"shows {len(twice)} markers twice, {twice[0]:.0f} for one: two boards alike are in it, cover one"


def _has_foreign(markers: np.ndarray, board: Any) -> bool:
    """Whether several markers do not belong to the board; fewer may be false detections."""
    return len(np.setdiff1d(markers, np.ravel(board.getIds()))) >= FEWEST_IMAGE_POINTS


def _markers(board: Any, detector: Any, grey: np.ndarray) -> Detected | str:
    corners, seen, _ = detector.detectMarkers(grey)
    markers = _numbers(seen)
    if twice := _shown_twice(markers):
        return twice
    corners_of = dict(zip(np.ravel(board.getIds()).tolist(), np.asarray(board.getObjPoints(), float), strict=True))
    read = [(name, four) for name, four in zip(markers.tolist(), corners, strict=True) if name in corners_of]
    if not read:
        return "no marker of the target is read"
    names = np.array([f"{name}-{k}" for name, _ in read for k in range(4)])
    places = np.vstack([corners_of[name] for name, _ in read])
    image = np.vstack([np.asarray(four, float).reshape(4, 2) for _, four in read])
    return Detected(names, places, image, _has_foreign(markers, board))


def _checkerboard(cv2: Any, printed: TargetFile, grey: np.ndarray) -> Detected | str:
    shape = (printed.columns - 1, printed.rows - 1)
    done, corners = cv2.findChessboardCornersSB(grey, shape, flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY)
    if not done:
        return f"its {shape[0]} x {shape[1]} inner corners are not all seen"
    grid = _faced(np.asarray(corners, float).reshape(shape[1], shape[0], 2))
    if not printed.is_turned_unseen and _first_square(grey, grid) > _first_square(grey, grid[::-1, ::-1]) + DARKER:
        grid = grid[::-1, ::-1]
    return _of_grid(grid, printed.size or 0.0)


def _first_square(grey: np.ndarray, grid: np.ndarray) -> float:
    """The brightness of the outer square at a grid's first corner, which is black at the origin."""
    u, v = grid[0, 0] - 0.5 * (grid[1, 1] - grid[0, 0])
    row, column = (int(np.clip(round(float(x)), 0, most - 1)) for x, most in zip((v, u), grey.shape, strict=True))
    return float(grey[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2].mean())


def _circles(cv2: Any, printed: TargetFile, grey: np.ndarray) -> Detected | str:
    shape = (printed.columns, printed.rows)
    settings = cv2.SimpleBlobDetector_Params()
    settings.filterByArea, settings.minArea, settings.maxArea = True, 20.0, grey.size / 50
    settings.minDistBetweenBlobs = 3.0
    detector = cv2.SimpleBlobDetector_create(settings)
    blobs = detector.detect(grey)
    for how in (cv2.CALIB_CB_SYMMETRIC_GRID, cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING):
        done, centres = cv2.findCirclesGrid(grey, shape, flags=how, blobDetector=detector)
        if done:
            break
    else:
        return f"its {shape[0]} x {shape[1]} circles are not all seen ({len(blobs)} round spots are)"
    grid = _faced(np.asarray(centres, float).reshape(shape[1], shape[0], 2))
    if printed.large_circle:
        places, sizes = np.array([blob.pt for blob in blobs]), np.array([blob.size for blob in blobs])
        turned = [grid, grid[::-1, ::-1]]
        if shape[0] == shape[1]:
            turned += [_faced(grid.transpose(1, 0, 2)[::-1]), _faced(grid.transpose(1, 0, 2)[:, ::-1])]
        size = [float(sizes[np.linalg.norm(places - circle[0, 0], axis=1).argmin()]) for circle in turned]
        if max(size) < LARGER * float(np.median(sizes)):
            return "no circle at a corner is larger than the others"
        grid = turned[int(np.argmax(size))]
    return _markers_among(cv2, grey, grid) or _of_grid(grid, printed.size or 0.0)


def _markers_among(cv2: Any, grey: np.ndarray, grid: np.ndarray) -> str:
    """The message that markers stand where a grid (rows, columns, 2) [px] has circles, or an empty string.

    Their squares, slanted and blurred, are as round as the circles of a photograph.
    """
    spots = grid.reshape(-1, 2).astype(np.float32)
    outline = cv2.convexHull(spots)
    largest = {re.sub(r"_[0-9]+$", "", name).lower(): name for name in _dictionaries(cv2)}  # of each sort
    for name in largest.values():
        every = cv2.aruco.ArucoDetector(_dictionary(cv2, name)).detectMarkers(grey)[0]
        among = [four for four in every if _holds(cv2, outline, [four.reshape(4, 2).mean(axis=0)])]
        on = sum(_holds(cv2, four.reshape(4, 2), spots) for four in every)
        if max(len(among), on) >= FEWEST_IMAGE_POINTS:
            what = 'is it one of kind = "charuco" or "markers"?'
            return f"shows {plural(len(every), 'marker')}, as of {name}, where circles should be: {what}"
    return ""


def _holds(cv2: Any, outline: np.ndarray, points: Sequence[np.ndarray] | np.ndarray) -> int:
    """The number of points [px] within an outline."""
    return sum(cv2.pointPolygonTest(outline, tuple(map(float, point)), False) >= 0 for point in points)


def _faced(grid: np.ndarray) -> np.ndarray:
    """A grid (rows, columns, 2) [px], its rows reversed if it is mirrored, since targets are seen from the front."""
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return grid if along[0] * down[1] - along[1] * down[0] > 0 else grid[::-1]


def _of_grid(grid: np.ndarray, size: float) -> Detected:
    rows, columns = grid.shape[:2]
    j, i = np.divmod(np.arange(rows * columns), columns)
    return Detected(np.arange(rows * columns), size * np.column_stack([i, j, 0 * i]).astype(float), grid.reshape(-1, 2))
