"""Camera: where an image shows the points of a target, camera and target each in the world or on a link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

import casadi as ca
import numpy as np
import scipy
from pydantic import Field, field_validator, model_validator

from calflow.files.deferred import Rotation, pd
from calflow.files.toml import Angle, Angles3, FileModel, Length, Lengths3, Unit
from calflow.files.units import PIXEL
from calflow.measurements.measurements import image_numbers, spaced
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import FURTHEST, NOWHERE, PLACE, Links, Observation, Seen, Six
from calflow.observations.hand_eye import FEWEST_IMAGE_POINTS, Sighting, camera_and_target, focal_length, sighting
from calflow.observations.hand_eye_methods import METHODS, camera_by
from calflow.observations.lens import DISTORTION, Lens, Model, projected, slopes
from calflow.robot.frames import angles, crossing, placement, placement_matrix, vector
from calflow.robot.parts import PLACED_SD, UNKNOWN_BOUND, UNKNOWN_SD, Parameter

Pixels = Annotated[float, Unit("image")]
PixelPair = Annotated[tuple[float, float], Unit("image")]
WORLD, TOOL = "world", "tool"  # what is no link that a robot names
FOCAL_SD, CENTRE_SD = 0.2, 0.1  # of the focal length: of a lens that nobody knows
DISTORTION_SD = {"k": 0.3, "p": 0.02}  # by the first letter of a coefficient
LENS_SETTINGS = ("focal", "centre", "distortion")
PLACE_SETTINGS = tuple(f"{what}_{figure}" for what in ("camera", "target") for figure in ("origin", "rotation"))
STATED_LENS = 0.02  # of those: what a lens is usually off from what is stated, where nobody says by how much
USUAL_FOCAL = 1.2  # of an image's width
FEWEST_POSES = 3  # of which hand-eye calibration tells anything
IMAGES, ROWS = 50, 1500  # of these at most a camera is placed: more change nothing
LEAST_SQUARES = "least squares"
SETTLING = 100  # evaluations of such a fit at most: of images that are no robot's it has no end
ROBUST_ROUNDS = 3  # of fits in which the scale of what is robust settles
PLANNED_POINTS = 4  # of a target
INNER = 0.6  # of the image, in which the middle of a planned target is
NEAREST = 0.02  # m
MOST_OBLIQUE = np.deg2rad(60)  # between a target's normal and the way to the camera: further, points are found badly
SMALLEST_IMAGE = 0.15  # of the image's height: a target that is shown smaller tells little


class CameraSettings(FileModel):
    """Where camera and target are fixed, the lens, and what is known of all of it.

    What is stated is known, but for its standard deviation where there is one; what is not stated is found. A lens that is stated
    without one is taken for as good as stated lenses usually are; 0 says that it is exact. camera_on and target_on
    are "world", "tool" or the name of a link. Origins and rotations are in the frame of these; of poses that are to be planned
    they are needed, roughly, as is the target's size from its origin along x and y. size is the image's, focus the nearest and the
    furthest distance at which it is sharp.
    """

    camera_on: str = WORLD
    target_on: str = TOOL
    lens: Literal["brown", "fisheye"] = "brown"
    size: PixelPair | None = None
    focal: PixelPair | None = None
    focal_sd: Pixels | None = Field(default=None, ge=0)
    centre: PixelPair | None = None
    centre_sd: Pixels | None = Field(default=None, ge=0)
    distortion: tuple[float, ...] | None = None
    distortion_sd: float | None = Field(default=None, ge=0)
    camera_origin: Lengths3 | None = None
    camera_origin_sd: Length = Field(default=0.0, ge=0)
    camera_rotation: Angles3 | None = None
    camera_rotation_sd: Angle = Field(default=0.0, ge=0)
    target_origin: Lengths3 | None = None
    target_origin_sd: Length = Field(default=0.0, ge=0)
    target_rotation: Angles3 | None = None
    target_rotation_sd: Angle = Field(default=0.0, ge=0)
    print_scale_sd: Annotated[float, Unit("ratio")] = Field(default=0.0, ge=0)
    target_size: Annotated[tuple[float, float], Unit("length")] | None = None
    focus: Annotated[tuple[float, float], Unit("length")] | None = None

    @field_validator("focal", "size", "target_size")
    @classmethod
    def _are_lengths(cls, lengths: tuple[float, float] | None) -> tuple[float, float] | None:
        if lengths and min(lengths) <= 0:
            raise ValueError("expected two lengths that are more than nothing")
        return lengths

    @field_validator("focus")
    @classmethod
    def _is_a_range(cls, focus: tuple[float, float] | None) -> tuple[float, float] | None:
        if focus and not 0 <= focus[0] < focus[1]:
            raise ValueError("expected the nearest and then the furthest distance that is sharp")
        return focus

    @model_validator(mode="after")
    def _can_be(self) -> CameraSettings:
        if self.camera_on == self.target_on:
            raise ValueError(
                f"camera_on and target_on: both are {self.camera_on!r}, so that no pose changes what is seen"
            )
        if self.distortion is not None and len(self.distortion) > len(DISTORTION[self.lens]):
            raise ValueError(
                f"distortion: expected at most {', '.join(DISTORTION[self.lens])} of the lens '{self.lens}'"
            )
        return self


@dataclass(frozen=True)
class Eye:
    """One camera by its name: where it is thought to be on its link, and the figures of its lens."""

    name: str
    place: Six = NOWHERE
    lens: tuple[float, ...] = ()


@dataclass(frozen=True)
class Board:
    """One target by its name: where it is thought to be on its link, and some of its outermost points [m], (n, 3).

    front is 1 where its z axis leads away from who looks at it, -1 where it leads towards him.
    """

    name: str
    place: Six = NOWHERE
    points: tuple[tuple[float, float, float], ...] = ()
    front: float = 1.0


@dataclass(frozen=True)
class Camera(Observation):
    """(u, v) = lens(C⁻¹ T (1 + scale) point), C and T being the frames of camera and target, each on a link or in the world.

    The camera looks along its z axis, x to the right and y down; lens is Brown's model or a fisheye's, with OpenCV's
    coefficients. A row is one point of one target in one image; rows of a pose are an image. Several cameras, and targets,
    of one series are told apart by the columns `camera` and `target`; they have lenses and places of their own.
    near says that a place stated in the world without a standard deviation is so beside the base, which nothing places.
    """

    cameras: tuple[Eye, ...] = (Eye(""),)
    targets: tuple[Board, ...] = (Board(""),)
    near: bool = False

    id = "camera"
    title = "a target's points in images"
    columns = Reported(
        {"u": "image", "v": "image"},
        labels=("camera", "target"),
        within=dict.fromkeys(("px_x", "px_y", "px_z"), "length"),
        notes=("image", "point"),
    )
    settings = CameraSettings
    units = (PIXEL, PIXEL)
    of_marker = False
    size_setting = "print_scale_sd"
    touches = True
    asked = (
        "as [measurements.settings] states camera and target, do they see each other, is the target's z axis turned away from the "
        "camera, and are its size, the lens and the focus right?"
    )

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the cameras and targets that the rows name, in the places and with the lenses stated."""
        return cls(series, (), ()).extended(table)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return it with camera, target and lens as stated."""
        wanted = (
            "camera_origin",
            "camera_rotation",
            "target_origin",
            "target_rotation",
            "target_size",
            "focal",
            "centre",
        )
        if lacking := [name for name in wanted if series.setting(name) is None]:
            raise ValueError(
                f"state, roughly, where camera and target will be, how large it is, and the lens: {', '.join(lacking)}"
            )
        width, height = _pair(series, "target_size") or (0.0, 0.0)
        corners = np.array([(0.0, 0.0, 0.0), (width, 0.0, 0.0), (0.0, height, 0.0), (width, height, 0.0)])
        return cls(series, (_eye(series, ""),), (_target(series, "", corners),))

    @property
    def _model(self) -> Model:
        return _model(self.series)

    def lens(self, camera: int) -> Lens:
        """Return the nominal lens of a camera, by its number."""
        fx, fy, cx, cy, *distortion = self.cameras[camera].lens
        return Lens(self._model, (fx, fy), (cx, cy), tuple(distortion))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of each camera's place and lens, then of each target's place and print, where not known."""
        return tuple(parameter for group in self._described for parameter in group if parameter)

    def beside_base(self) -> Self:
        """Return the images of what stands near its stated place beside the base: a zero of joint 1 turns it about axis 1."""
        return replace(self, near=True)

    @property
    def _described(self) -> Iterator[tuple[Parameter | None, ...]]:
        """All errors there may be, camera by camera and target by target; None of what is known."""
        for k, eye in enumerate(self.cameras):
            part = self._part_of(eye)
            yield (*self._place(part, "camera", eye.place), *self._lens_errors(part, k))
        for target in self.targets:
            part = self._part_of(target)
            sd = self.series.number(self.size_setting) or 0.0
            size = self._error(part, "scale", "1", sd, FURTHEST * sd, 0.0, "scale of the print")
            yield *self._place(part, "target", target.place), size and replace(size, of_size=True)

    def _place(self, part: str, what: str, nominal: Six) -> list[Parameter | None]:
        parameters = []
        known = PLACED_SD if self.near and self._link(f"{what}_on") is None else 0.0
        for (symbol, unit), figure in zip(PLACE.items(), nominal, strict=True):
            kind = "origin" if unit == "m" else "rotation"
            free = self.series.setting(f"{what}_{kind}") is None
            sd = UNKNOWN_SD if free else self.series.number(f"{what}_{kind}_sd") or known
            bound = UNKNOWN_BOUND if free else FURTHEST * sd
            parameters.append(self._error(part, symbol, unit, sd, bound, figure, f"place of the {what}, {symbol}"))
        return parameters

    def _lens_errors(self, part: str, camera: int) -> list[Parameter | None]:
        errors, sds = [], self.lens_sd(camera)
        for k, (symbol, figure) in enumerate(zip(Lens(self._model).symbols, self.cameras[camera].lens, strict=True)):
            sd = float(sds[k])
            bound = min(FURTHEST * sd, 0.9 * figure) if k < 2 else FURTHEST * sd
            errors.append(self._error(part, symbol, "px" if k < 4 else "1", sd, bound, figure, f"{symbol} of the lens"))
        return errors

    def lens_sd(self, camera: int, unknown: bool = False) -> np.ndarray:
        """Return the standard deviation of each of a lens's figures, (4 + n,); unknown says that none of them were stated."""
        focal, bends = self.cameras[camera].lens[0], DISTORTION[self._model]
        usual = [FOCAL_SD * focal] * 2 + [CENTRE_SD * focal] * 2 + [DISTORTION_SD[symbol[0]] for symbol in bends]
        names = np.repeat(LENS_SETTINGS, (2, 2, len(bends)))
        stated = [self.series.number(f"{name}_sd") for name in names]
        return np.array(
            [
                sd if unknown or self.series.setting(name) is None else STATED_LENS * sd if of_name is None else of_name
                for name, sd, of_name in zip(names, usual, stated, strict=True)
            ]
        )

    def _error(
        self, part: str, symbol: str, unit: str, sd: float, bound: float, figure: float, meaning: str
    ) -> Parameter | None:
        return Parameter(self.id, part, symbol, unit, sd, -bound, bound, figure=figure, meaning=meaning) if sd else None

    @property
    def reports(self) -> int:
        """Where the point is shown, which point it is, of which target, in which camera."""
        return 5 + len(self.cameras) + len(self.targets)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the image points, the target's points, then camera and target one-hot."""
        of_camera, of_target = _names(table, "camera"), _names(table, "target")
        which = [of_camera == eye.name for eye in self.cameras] + [of_target == board.name for board in self.targets]
        return np.vstack([table[["u", "v", "px_x", "px_y", "px_z"]].to_numpy(float).T, np.array(which, dtype=float)])

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the difference of the images."""
        point, figures = self._there(p, seen, y)
        return projected(self._model, seen.device(point), figures) - y[:2]

    def _there(self, p: ca.SX, seen: Seen, y: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return where a row's point is in the camera's frame (3,) [m], and the figures of the camera's lens."""
        values = _spread(self._described, p)
        n = len(self.cameras)
        eyes = [
            ca.vertcat(ca.vec(_moved(eye.place, figures[:6])), ca.DM(eye.lens) + figures[6:])
            for eye, figures in zip(self.cameras, values[:n], strict=True)
        ]
        boards = [
            ca.vertcat(ca.vec(_moved(target.place, figures[:6])), figures[6])
            for target, figures in zip(self.targets, values[n:], strict=True)
        ]
        eye, board = _chosen(eyes, y[5 : 5 + n]), _chosen(boards, y[5 + n :])
        there = ca.reshape(board[:16], 4, 4) @ ca.vertcat(seen.target((1 + board[16]) * y[2:5]), 1)
        here = self._frame(seen, "camera_on") @ ca.reshape(eye[:16], 4, 4)
        there = _inverse(here) @ self._frame(seen, "target_on") @ there
        return there[:3], eye[16:]

    def _frame(self, seen: Seen, what: str) -> ca.SX:
        link = self._link(what)
        return ca.SX.eye(4) if link is None else seen.link(link)

    def _link(self, what: str) -> str | None:
        """The name of the link that something is on, none of the flange; None of the world."""
        on = str(self.series.setting(what, WORLD if what == "camera_on" else TOOL))
        return {WORLD: None, TOOL: ""}.get(on, on)

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Find lens, camera and target by what the nominal robot's links (n_rows, 4, 4) and the images agree on."""
        frames = self._frames(links, len(table))
        return self._begun(table, image_numbers(table), *frames)._settled(table, *frames)._faced(table, *frames)

    def _frames(self, links: Links, n_rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Where what camera and target are on is, of each row (n_rows, 4, 4)."""
        camera, target = (
            np.tile(np.eye(4), (n_rows, 1, 1)) if link is None else links(link)
            for link in (self._link("camera_on"), self._link("target_on"))
        )
        return camera, target

    def _which(self, reported: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the numbers of camera and target, each (n_rows,), in what the rows report (5 + both, n_rows)."""
        of_camera, of_target = np.split(reported[5:], [len(self.cameras)])
        return of_camera.argmax(axis=0), of_target.argmax(axis=0)

    def _faced(self, table: pd.DataFrame, hand: np.ndarray, base: np.ndarray) -> Self:
        """The observation with the sides from which its targets are seen."""
        of_camera, of_target = self._which(self.reported(table))
        eyes, boards = (
            np.array([placement_matrix(placed.place) for placed in every]) for every in (self.cameras, self.targets)
        )
        seen = np.linalg.inv(hand @ eyes[of_camera]) @ base @ boards[of_target]
        along = (seen[:, :3, 2] * seen[:, :3, 3]).sum(axis=1)
        front = np.bincount(of_target, np.sign(along), len(boards))
        return replace(
            self,
            targets=tuple(
                replace(target, front=-1.0 if k < 0 else 1.0) for target, k in zip(self.targets, front, strict=True)
            ),
        )

    def _begun(self, table: pd.DataFrame, images: np.ndarray, hand: np.ndarray, base: np.ndarray) -> Self:
        """Lens and places in closed form, each camera and target by the images of one that was placed already, if there are any."""
        which = self.reported(table)
        of_camera, of_target = self._which(which)
        image, point = which[:2].T, which[2:5].T
        cameras, targets, sighted = list(self.cameras), list(self.targets), set[int]()
        placed = {("camera", k) for k in range(len(cameras)) if self.series.setting("camera_origin") is not None}
        placed |= {("target", k) for k in range(len(targets)) if self.series.setting("target_origin") is not None}
        for c, t in sorted({*zip(of_camera.tolist(), of_target.tolist(), strict=True)}):
            rows = np.flatnonzero((of_camera == c) & (of_target == t))
            kept = spaced(np.unique(images[rows]), IMAGES)
            views = [rows[images[rows] == image_number] for image_number in kept]
            if c not in sighted:
                cameras[c] = self._with_lens(c, views, point, image).cameras[c]
            at, seen = _sighted(replace(self, cameras=tuple(cameras)).lens(c), views, point, image)
            if not seen:
                continue
            sighted.add(c)
            x, y = _places(
                seen,
                hand[at],
                base[at],
                placement_matrix(cameras[c].place) if ("camera", c) in placed else None,
                placement_matrix(targets[t].place) if ("target", t) in placed else None,
            )
            cameras[c] = replace(cameras[c], place=_six(x)) if ("camera", c) not in placed else cameras[c]
            targets[t] = replace(targets[t], place=_six(y)) if ("target", t) not in placed else targets[t]
            placed |= {("camera", c), ("target", t)}
        return replace(self, cameras=tuple(cameras), targets=tuple(targets))

    def places_seen(self, table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
        """Return places by the images alone, those of the camera and target with most of them.

        They are rows of the table, one of each image (n,), and where the target's middle is in the camera's frame (n, 3) [m]; of a
        camera that moves, where a point before it that moves with it is in the target's. It is where the target is on average, so
        that the target's tilt, which an image tells worst, hardly moves it.
        """
        which, images = self.reported(table), image_numbers(table)
        of_camera, of_target = self._which(which)
        first = np.unique(images, return_index=True)[1]
        pair = of_camera * len(self.targets) + of_target
        most = int(np.bincount(pair[first]).argmax())
        image, point, c = which[:2].T, which[2:5].T, most // len(self.targets)
        views = [np.flatnonzero(images == images[row]) for row in first[pair[first] == most]]
        at, seen = _sighted(self._with_lens(c, views, point, image).lens(c), views, point, image)
        poses = np.array([sighted[0] for sighted in seen]).reshape(-1, 4, 4)
        places = poses[:, :3, :3] @ point[np.concatenate(views)].mean(axis=0) + poses[:, :3, 3]
        if self._link("camera_on") is not None and len(at):
            places = np.einsum("nji,nj->ni", poses[:, :3, :3], places.mean(axis=0) - places)
        return at, places

    def _with_lens(self, camera: int, views: Sequence[np.ndarray], point: np.ndarray, image: np.ndarray) -> Self:
        """The observation with the lens of a camera by its views (rows of an image), unless it is stated."""
        if self.series.setting("focal") is not None:
            return self
        cameras = list(self.cameras)
        cameras[camera] = replace(
            cameras[camera], lens=_first_lens(cameras[camera].lens, [(point[v], image[v]) for v in views])
        )
        return replace(self, cameras=tuple(cameras))

    def _settled(self, table: pd.DataFrame, hand: np.ndarray, base: np.ndarray) -> Self:
        """The observation with all that is not stated where a robust fit of the images, some of them, has it."""
        exact = tuple((f"{name}_sd", 0.0) for name in (*LENS_SETTINGS, *PLACE_SETTINGS))
        fixed = replace(self, series=replace(self.series, settings=(*self.series.settings, *exact)), near=False)
        images = image_numbers(table)
        some = np.flatnonzero(np.isin(images, spaced(np.unique(images), IMAGES)))
        some = some[:: max(1, len(some) // ROWS)]
        table, hand, base = table.iloc[some], hand[some], base[some]
        sd = np.array([parameter.prior_sd for parameter in fixed.parameters()])
        if not len(sd) or not len(table):
            return self
        rows = (hand, base, self.reported(table))
        residual = fixed._of_rows(fixed.error, *rows)
        jacobian = fixed._of_rows(lambda p, seen, y: ca.vec(ca.jacobian(fixed.error(p, seen, y), p)), *rows)

        def missed(x: np.ndarray) -> np.ndarray:
            return np.append(np.nan_to_num(residual(sd * x).T.ravel(), nan=1e6), x)

        def slope(x: np.ndarray) -> np.ndarray:
            by_row = jacobian(sd * x).reshape(len(sd), 2, -1)
            return np.vstack([np.nan_to_num(by_row.transpose(2, 1, 0).reshape(-1, len(sd)) * sd), np.eye(len(sd))])

        correction = np.zeros(len(sd))
        for _ in range(ROBUST_ROUNDS):
            scale = max(float(np.median(np.abs(missed(correction)[: -len(sd)]))), PIXEL.usual)
            fit = scipy.optimize.least_squares(
                missed, correction, slope, loss="soft_l1", f_scale=2 * scale, max_nfev=SETTLING
            )
            correction = fit.x
        return replace(fixed._by(sd * correction), series=self.series, near=self.near)

    def _of_rows(
        self, of: Callable[[ca.SX, Seen, ca.SX], ca.SX], hand: np.ndarray, base: np.ndarray, reported: np.ndarray
    ) -> Callable[[np.ndarray], np.ndarray]:
        """Return the function of the parameters that tells a quantity of all rows (size, n_rows), given an undisturbed device.

        hand and base (n_rows, 4, 4) are where what camera and target are on is.
        """
        p, y = ca.SX.sym("p", len(self.parameters())), ca.SX.sym("y", self.reports)
        hand_pose, other = ca.SX.sym("h", 4, 4), ca.SX.sym("b", 4, 4)
        seen = Seen(ca.SX(3, 1), lambda: ca.SX.eye(3), lambda point: point,
                    lambda link: hand_pose if link == self._link("camera_on") else other, lambda: ca.SX(3, 1))  # fmt: skip
        function = ca.Function("of_row", [p, ca.vec(hand_pose), ca.vec(other), y], [ca.densify(of(p, seen, y))])
        poses = (frame.transpose(0, 2, 1).reshape(-1, 16).T for frame in (hand, base))
        rows = [ca.DM(values) for values in (*poses, reported)]
        return lambda values: np.array(function(ca.DM(values), *rows))

    def _by(self, p: np.ndarray) -> Self:
        """The observation about p."""
        values = [np.array(ca.DM(figures)).ravel() for figures in _spread(self._described, ca.SX(p))]
        n = len(self.cameras)
        cameras = [
            replace(
                eye, place=_moved_by(eye.place, figures[:6]), lens=tuple((np.array(eye.lens) + figures[6:]).tolist())
            )
            for eye, figures in zip(self.cameras, values[:n], strict=True)
        ]
        targets = [
            replace(target, place=_moved_by(target.place, figures[:6]))
            for target, figures in zip(self.targets, values[n:], strict=True)
        ]
        return replace(self, cameras=tuple(cameras), targets=tuple(targets))

    def _part_of(self, thing: Eye | Board) -> str:
        """Return the name of the parameters' part of a camera or target."""
        of = (self.part, thing.name) if isinstance(thing, Eye) else (self.series.name, "target", thing.name)
        return "-".join(filter(None, of))

    @property
    def placements(self) -> dict[str, Six]:
        """The cameras and the targets, each in the frame of its link."""
        cameras = {self._part_of(eye): eye.place for eye in self.cameras}
        return cameras | {self._part_of(target): target.place for target in self.targets}

    def placed(self, placements: Mapping[str, Six]) -> Self:
        """Return it with the cameras and targets of an earlier one."""
        return replace(
            self,
            cameras=tuple(replace(eye, place=placements[self._part_of(eye)]) for eye in self.cameras),
            targets=tuple(replace(target, place=placements[self._part_of(target)]) for target in self.targets),
        )

    @property
    def n_seen(self) -> int:
        """Number of a target's outermost points."""
        return len(self.targets[0].points)

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return one of a target's outermost points after the other, shown nowhere: poses are planned by derivatives."""
        local = np.array(self.targets[0].points)[np.arange(len(points)) % len(self.targets[0].points)]
        which = np.zeros((len(self.cameras) + len(self.targets), len(points)))
        which[[0, len(self.cameras)]] = 1.0
        return np.vstack([np.zeros((2, len(points))), local.T, which])

    def touched(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the middle of the first target shown all over the first image, by Halton's sequence."""
        places = INNER * (scipy.stats.qmc.Halton(2, scramble=False).random(len(points)) - 0.5) * self._size
        expected = self.expected(points, rotations)
        expected[:2] = (np.array(self.lens(0).centre) + places).T
        expected[2:5] = np.mean(self.targets[0].points, axis=0)[:, None]
        return expected

    @property
    def _size(self) -> np.ndarray:
        """The image's width and height [px]."""
        return np.array(_pair(self.series, "size") or 2 * np.array(self.lens(0).centre))

    def sees(self, links: Links) -> np.ndarray:
        """Return whether the first target is wholly in the first image, sharp, large enough and not too oblique, (n_rows,)."""
        hand, base = self._frames(links, 1)
        camera, target = placement_matrix(self.cameras[0].place), placement_matrix(self.targets[0].place)
        seen = np.linalg.inv(hand @ camera) @ base @ target
        local = np.array(self.targets[0].points)
        there = np.einsum("nij,kj->nki", seen[:, :3, :3], local) + seen[:, None, :3, 3]
        far, way = there[:, :, 2], there.mean(axis=1)
        good = (far > NEAREST).all(axis=1)
        if focus := _pair(self.series, "focus"):
            good &= ((far > focus[0]) & (far < focus[1])).all(axis=1)
        slant = self.targets[0].front * (way * seen[:, :3, 2]).sum(axis=1) / np.linalg.norm(way, axis=1)
        good &= slant > np.cos(MOST_OBLIQUE)
        shown_at = (
            self.lens(0)
            .image(np.where(good[:, None, None], there, [0.0, 0.0, 1.0]).reshape(-1, 3))
            .reshape((*far.shape, 2))
        )
        good &= ((shown_at > 0) & (shown_at < self._size)).all(axis=(1, 2))
        return np.asarray(good & (np.ptp(shown_at, axis=1).max(axis=1) > SMALLEST_IMAGE * self._size.min()))

    def in_space(self, values: np.ndarray, links: Links, table: pd.DataFrame, error: np.ndarray) -> np.ndarray:
        """Return by how much what moves is to be shifted for its image to fit best: the camera, or the target's middle."""
        rows = (*self._frames(links, len(table)), self.reported(table))
        there, figures = np.split(
            self._of_rows(lambda *row: ca.vertcat(*self._there(*row)), *rows)(values).T, [3], axis=1
        )
        slope, _ = slopes(self._model, there, figures)
        by_turn = slope @ crossing(there)
        images = np.unique(image_numbers(table), return_inverse=True)[1]
        moved = _fitting_motion(np.concatenate([-slope, by_turn], axis=2), error, images)
        if self._link("camera_on") is not None:
            return moved[:, :3]
        count = np.bincount(images)
        middle = np.stack([np.bincount(images, axis) / count for axis in there.T], axis=1)
        return moved[:, :3] + np.cross(moved[:, 3:], middle)

    def closed_forms(self, values: np.ndarray, links: Links, table: pd.DataFrame) -> dict[str, Self | str]:
        """Return what the usual methods of hand-eye calibration, and a fit of their points, make of at most IMAGES images.

        The lens is that of values. The target is where all images together, by a method, have it on average. None where several
        cameras or targets are there, or one is stated.
        """
        stated = any(self.series.setting(f"{what}_origin") is not None for what in ("camera", "target"))
        if stated or len(self.cameras) > 1 or len(self.targets) > 1:
            return {}
        images, which = image_numbers(table), self.reported(table)
        views = [np.flatnonzero(images == image) for image in spaced(np.unique(images), IMAGES)]
        errors = np.array(ca.DM(_spread(self._described, ca.SX(values))[0])).ravel()[6:]
        lens = tuple(map(float, np.array(self.cameras[0].lens) + errors))
        seeing = replace(self, cameras=(replace(self.cameras[0], lens=lens),))
        at, seen = _sighted(seeing.lens(0), views, which[2:5].T, which[:2].T)
        if len(seen) < FEWEST_POSES:
            return {}
        hand, base = (frame[at] for frame in self._frames(links, len(table)))
        chosen = np.maximum(camera_and_target(seen, hand, base)[2], 0)
        poses = np.array([sighted[k] for sighted, k in zip(seen, chosen, strict=True)])
        motion, made = np.linalg.inv(base) @ hand, dict[str, Self | str]()
        for method in METHODS:
            try:
                camera = camera_by(method, motion, poses)
            except ValueError as failed:
                made[method] = str(failed)
                continue
            target, every = np.eye(4), motion @ camera @ poses
            target[:3, :3] = Rotation.from_matrix(every[:, :3, :3]).mean().as_matrix()
            target[:3, 3] = every[:, :3, 3].mean(axis=0)
            eye, board = replace(seeing.cameras[0], place=_six(camera)), replace(self.targets[0], place=_six(target))
            made[method] = replace(self, cameras=(eye,), targets=(board,))
        if placed := [placed for placed in made.values() if not isinstance(placed, str)]:
            known = (("focal", lens[:2]), ("centre", lens[2:4]), ("distortion", lens[4:]))
            series = replace(self.series, settings=(*self.series.settings, *known))
            settled = replace(placed[-1], series=series)._settled(table, *self._frames(links, len(table)))
            made[LEAST_SQUARES] = replace(settled, series=self.series)
        return made

    def extended(self, table: pd.DataFrame) -> Self:
        """Return it with the new cameras and targets."""
        eyes, boards = {eye.name for eye in self.cameras}, {target.name for target in self.targets}
        of_target = _names(table, "target")
        cameras = [_eye(self.series, name) for name in sorted({*_names(table, "camera")} - eyes)]
        points = table[["px_x", "px_y", "px_z"]].to_numpy(float)
        targets = [_target(self.series, name, points[of_target == name]) for name in sorted({*of_target} - boards)]
        return replace(self, cameras=(*self.cameras, *cameras), targets=(*self.targets, *targets))


def _eye(series: Series, name: str) -> Eye:
    """A camera as a study states it, where nothing is stated at the origin with a lens of no distortion."""
    size, focal = _pair(series, "size") or (0.0, 0.0), _pair(series, "focal") or (1.0, 1.0)
    centre = _pair(series, "centre") or (size[0] / 2, size[1] / 2)
    distortion = series.setting("distortion")
    figures = Lens(_model(series), focal, centre, distortion if isinstance(distortion, tuple) else ()).figures
    return Eye(name, _stated_place(series, "camera"), tuple(map(float, figures)))


def _model(series: Series) -> Model:
    return "fisheye" if series.setting("lens") == "fisheye" else "brown"


def _target(series: Series, name: str, points: np.ndarray) -> Board:
    ways = np.array([[1, 1, 0], [-1, -1, 0], [1, -1, 0], [-1, 1, 0], [0, 0, 1]])
    outer = dict.fromkeys(int(k) for k in (points @ ways.T).argmax(axis=0))
    return Board(name, _stated_place(series, "target"), tuple(vector(points[k]) for k in [*outer][:PLANNED_POINTS]))


def _pair(series: Series, name: str) -> tuple[float, float] | None:
    stated = series.setting(name)
    return (stated[0], stated[1]) if isinstance(stated, tuple) else None


def _stated_place(series: Series, what: str) -> Six:
    zero = NOWHERE[:3]
    return (*(series.triple(f"{what}_origin") or zero), *(series.triple(f"{what}_rotation") or zero))


def _first_lens(figures: tuple[float, ...], views: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[float, ...]:
    """A lens without distortion by the images of a plane, about the middle of the image, or of all that was seen."""
    every = np.concatenate([image for _, image in views])
    low, high = every.min(axis=0), every.max(axis=0)
    centre = np.array(figures[2:4]) if any(figures[2:4]) else (low + high) / 2
    width = 2 * float(centre[0]) if any(figures[2:4]) else float((high - low).max())
    flat = [(point[:, :2], image - centre) for point, image in views if np.ptp(point[:, 2]) == 0 and len(point) >= 6]
    focal = focal_length(flat, USUAL_FOCAL * width)
    return (focal, focal, *map(float, centre), *figures[4:])


def _sighted(
    lens: Lens, views: Sequence[np.ndarray], point: np.ndarray, image: np.ndarray
) -> tuple[np.ndarray, list[Sighting]]:
    """The first row of each view (rows of an image) that shows where its target is, and the target's candidate poses in it."""
    sightings = [(view[0], sighting(point[view], lens.rays(image[view]))) for view in views]
    seen = [(row, sighted) for row, sighted in sightings if sighted]
    return np.array([row for row, _ in seen], dtype=int), [sighted for _, sighted in seen]


def _places(
    seen: Sequence[Sighting], hand: np.ndarray, base: np.ndarray, camera: np.ndarray | None, target: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Camera and target (4, 4) on their links; one that is known tells the other."""
    every = [(k, pose) for k, sighted in enumerate(seen) for pose in sighted]
    if camera is None and target is None:
        camera, target, _ = camera_and_target(seen, hand, base)
        return camera, target
    if camera is None:
        candidates = np.array([np.linalg.inv(hand[k]) @ base[k] @ target @ np.linalg.inv(pose) for k, pose in every])
        return _commonest(candidates), np.asarray(target)
    if target is None:
        return camera, _commonest(np.array([np.linalg.inv(base[k]) @ hand[k] @ camera @ pose for k, pose in every]))
    return camera, target


def _commonest(places: np.ndarray) -> np.ndarray:
    """The place (4, 4) that is turned least from the others, in the median."""
    turns = Rotation.from_matrix(places[:, :3, :3])
    apart = [float(np.median((turns * turn.inv()).magnitude())) for turn in turns]
    return np.asarray(places[int(np.argmin(apart))])


def _names(table: pd.DataFrame, column: str) -> np.ndarray:
    return (table[column].astype(str) if column in table else pd.Series("", table.index)).to_numpy(dtype=object)


def _six(place: np.ndarray) -> Six:
    x, y, z = map(float, place[:3, 3])
    rx, ry, rz = map(float, angles(Rotation.from_matrix(place[:3, :3])))
    return x, y, z, rx, ry, rz


def _moved_by(place: Six, by: np.ndarray) -> Six:
    return _six(placement_matrix(place) @ placement_matrix(by))


def _moved(place: Six, by: ca.SX) -> ca.SX:
    return placement(ca.DM(place)) @ placement(by)


def _spread(described: Iterator[tuple[Parameter | None, ...]], p: ca.SX) -> list[ca.SX]:
    """The values of each group of errors, nothing of those that are known."""
    values, at = [], 0
    for group in described:
        own_values = ca.SX(len(group), 1)
        for k, parameter in enumerate(group):
            if parameter:
                own_values[k], at = p[at], at + 1
        values.append(own_values)
    return values


def _fitting_motion(slope: np.ndarray, error: np.ndarray, images: np.ndarray) -> np.ndarray:
    """The motions (n_images, 6) that take off most of the errors (n_rows, 2), nan where points do not tell them."""
    products = np.concatenate([slope, error[:, :, None]], axis=2)
    sums = np.zeros((images.max() + 1, 7, 7))
    np.add.at(sums, images, products.transpose(0, 2, 1) @ products)
    determined = (np.bincount(images) >= FEWEST_IMAGE_POINTS) & (
        np.linalg.matrix_rank(sums[:, :6, :6], hermitian=True) == 6
    )
    moved = np.full((len(sums), 6), np.nan)
    moved[determined] = -np.linalg.solve(sums[determined, :6, :6], sums[determined, :6, 6:])[:, :, 0]
    return moved


def _chosen(columns: Sequence[ca.SX], which: ca.SX) -> ca.SX:
    return columns[0] if len(columns) == 1 else ca.horzcat(*columns) @ which


def _inverse(frame: ca.SX) -> ca.SX:
    turn = frame[:3, :3].T
    return ca.vertcat(ca.horzcat(turn, -turn @ frame[:3, 3]), ca.DM([[0, 0, 0, 1]]))
