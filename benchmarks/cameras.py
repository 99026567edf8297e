"""Robots calibrated by photographs alone: whether what is promised in space holds, and what is named.

    python benchmarks/cameras.py cases --cases 48 --seed 1 --out cameras.csv
    python benchmarks/cameras.py two_arms --cases 12 --seed 1 --out two_arms.csv
    python benchmarks/cameras.py bad_plans --cases 40 --seed 1 --out bad_plans.csv
    python benchmarks/cameras.py good_plans --cases 40 --seed 1 --out good_plans.csv
    python benchmarks/cameras.py look_alikes --cases 24 --seed 1 --out look_alikes.csv

Robots, cameras and boards are of camera_physics.py: 0.2 px of noise, errors of all figures (0.5 mm, 1 mrad), lens, camera and board
unknown. cases: 60 images (80 of two arms), every fourth hides nothing, the others one cause at 2, 3 or 5 limits of what no figure
of robot, camera, board or lens can imitate (LIMIT of other_forms.py), or as large as LARGEST says. The tool's error is over random
poses all over the joints' ranges, base and tool taught; promised is the run's `in_space.csv`. Figures that others can stand for are
not held against their intervals. bad_plans: few images, all from nearly one place, a lens that is stated and wrong, or several of
these; a tool worse than the robot as its maker says is to be said. good_plans: many images from all sides, the lens unknown or
stated as it is; of these that is to be said of few. Of both the probability of being nearer is held against the share that is.
look_alikes: few images from nearly one place, which hardly tell
the zero of the shoulder, off by ZERO, from where board or camera are mounted, or from the lens. By the derivatives of these images
a group is its look-alike where the zero's variance would fall by half were the group known; that is to be told in one statement.
The poses of `next` part them where they make the zero twice as sure; whether any could, the best of many poses tell. The robot is
then photographed at these poses, too, and calibrated by all images.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import kept_cases
import numpy as np
import pandas as pd
from camera_physics import (
    CELLS,
    DH,
    LENS,
    SIZE,
    Array,
    Cell,
    Figure,
    Rows,
    board,
    figures,
    hand_points,
    images,
    poses,
    slopes,
    stands_out,
    told_alone,
    untaught,
)
from foreign_forms import ANGULAR, DIRECTIONAL
from foreign_study import joint_of, names_of, rivals_of
from kept_cases import Place, Row
from other_forms import LIMIT, LIMITS
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.deployment.in_space import ALONE, RANGES, SpaceError, is_no_better
from calflow.stages.measuring_loop import next_poses

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from observations.photographed import frame

SIGMA, NEW, TOOL = 0.2, 300, (0.03, 0.02, 0.12)  # px; poses; m
NULLS, HELD_OUT = 4, 0.3
NORMAL = 1.959964
ZERO, SHOULDER, FURTHER, MANY = 4e-3, 2, 12, 150  # rad; joint; poses proposed; poses to choose the best from
PLACE = ("x", "y", "z", "rx", "ry", "rz")
ALIKE_GROUPS = {
    "board": tuple(f"target.{one}" for one in PLACE), "mount": tuple(f"camera.{one}" for one in PLACE),
    "lens": tuple(f"camera.{one}" for one in LENS),
}  # fmt: skip
DIAGNOSED = 5  # every so many bad plans are diagnosed too, which tells of the tool what identifying does
UNSURE = 0.7  # mrad: not three times as sure as before the images
FOCAL_WRONG, NARROW, FEW = (0.01, 0.05), (0.05, 0.4), (6, 12)
BAD_PLANS = (("few",), ("narrow",), ("lens",), ("few", "narrow"), ("narrow", "lens"), ("few", "lens"))
GOOD_PLANS = (("",), ("known",))
STATED = [0.0, 0.05, 0.5, 0.8, 0.95, 0.99, 1.0]  # bins of the probability of being nearer
# what a cause may be called, and how many joints away
ALIKE: dict[str, dict[str, tuple[int, ...]]] = {
    "joint-eccentricity": ANGULAR | {"gravity-deflection": (0,), "gear-ratio-error": (0,)},
    "periodic-joint-error": ANGULAR,
    "joint-backlash": DIRECTIONAL,
    "joint-compliance": {"joint-compliance": (0,), "gravity-deflection": (0,), "nonlinear-joint-stiffness": (0,)},
    "camera-slip": {"camera-slip": ()},
}
LARGEST = {
    "joint-eccentricity": 1e-3,
    "periodic-joint-error": 1e-3,
    "joint-backlash": 1e-3,
    "joint-compliance": 1e-4,
    "camera-slip": 2e-3,
}


@dataclass(frozen=True)
class Hidden:
    """A cause, its joint (from 1; 0: none), its size, and where in its wave, or in the images, it is."""

    cause: str
    joint: int
    size: float
    phase: float
    order: int

    def moved(self, cell: Cell, q: Array, side: Array) -> Array:
        """By how much joints stand beside their readings (poses, n) [rad]."""
        off, i = np.zeros_like(q), self.joint - 1
        match self.cause:
            case "joint-eccentricity":
                off[:, i] = self.size * np.cos(q[:, i] + self.phase)
            case "periodic-joint-error":
                off[:, i] = self.size * np.cos(self.order * q[:, i] + self.phase)
            case "joint-backlash":
                off[:, i] = 0.5 * self.size * side[:, i]
            case "joint-compliance":
                off[:, i] = self.size * cell.robot.torque(i, q)
        return off

    def slip(self, n: int) -> Array:
        """By how much the camera stands elsewhere at each image (n, 4, 4)."""
        whole = np.tile(np.eye(4), (n, 1, 1))
        if self.cause == "camera-slip":
            way = np.random.default_rng(self.order).normal(size=6) * self.size
            whole[int(n * (0.3 + 0.4 * self.phase / (2 * np.pi))) :] = frame(Rotation.from_rotvec(3 * way[3:]), way[:3])
        return whole

    def shown(self, cell: Cell, rows: Rows) -> Array:
        """Where the board's points are shown with it."""
        return images(cell, rows, self.moved(cell, rows.q, rows.side), self.slip(len(rows)))

    def may_be_called(self, cause: str, joint: int) -> bool:
        """Whether a name at a joint (0: none) is of its class."""
        near = ALIKE.get(self.cause, {})
        return cause in near and (not near[cause] or not joint or joint - self.joint in near[cause])


def placed(cell: Cell, rows: Rows, limits: float, cause: str, rng: np.random.Generator) -> tuple[Hidden, float]:
    """A cause at a joint that shows it, so many limits large or as large as allowed, and at how many limits that is."""
    slope, still = slopes(cell, rows), images(cell, rows)
    moving = sorted({k + 1 for view in cell.views for k in cell.robot.chain(view.target_on or view.camera_on)[:-1]})
    places = {"camera-slip": [0], "joint-compliance": list(cell.loaded)}.get(cause, moving)
    tried = []
    for joint in rng.permutation(places):
        h = Hidden(cause, int(joint), 1e-6, float(rng.uniform(0, 2 * np.pi)), int(rng.integers(2, 7)))
        seen = np.sqrt(1 - HELD_OUT) * stands_out(h.shown(cell, rows) - still, slope, SIGMA) / LIMIT
        size = min(limits / seen * h.size, LARGEST[cause])
        tried.append((Hidden(cause, h.joint, size, h.phase, h.order), seen * size / h.size))
        if tried[-1][1] > 0.999 * limits:
            return tried[-1]
    return max(tried, key=lambda one: one[1])


def write_study(folder: Path, cell: Cell, rows: Rows, seen: Array, rng: np.random.Generator, lens: str = "") -> None:
    """Write robot, study and image points as a user would."""
    folder.mkdir(parents=True, exist_ok=True)
    robot, hands = cell.robot, {link: name for name, link in cell.hands.items()}
    names = {robot.n: "head"} | hands if len(hands) > 1 else {}
    lines = [
        f'name = "{cell.name}"',
        f'convention = "{"modified-dh" if robot.modified else "dh"}"',
        "[base]",
        "known = true",
    ]
    for i, (alpha, a, theta, d) in enumerate(robot.figures):
        low, high = robot.limits[i]
        lines += ["", "[[joints]]", f"alpha_rad = {alpha:.12g}", f"a_m = {a:.12g}", f"theta_rad = {theta:.12g}", f"d_m = {d:.12g}",
                  f"limits_rad = [{low:.9g}, {high:.9g}]", f"mass_kg = {robot.mass[i]}",
                  f"com_m = {_list(robot.com[i])}"]  # fmt: skip
        lines += [f'link = "{names[i + 1]}"'] if i + 1 in names else []
        if i in robot.branching:
            lines += ['parent = "base"', f"origin_m = {_list(robot.mount[i][:3, 3])}"]
    for name, link in cell.hands.items():
        lines += ["", f"[markers.{name}]", f"point_m = {_list(TOOL)}", "known = false"]
        lines += [f'on = "{names[link]}"'] if names else []
    (folder / "robot.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = f'name = "{folder.name.lower()}"\nrobot = "robot.toml"\nworkflow = "diagnose"\nseed = 1\neffects = ["geometry"]\n'
    stated, points = rng.random() < 0.5, board()
    for v, view in enumerate(cell.views):
        own = np.flatnonzero(rows.view == v)
        shown = seen[own].reshape(-1, 2)
        table = {"pose": np.repeat(own + 1, len(points))}
        table |= {f"q{i + 1}_rad": np.repeat(rows.q[own, i], len(points)) for i in range(robot.n)}
        table |= {f"approach{i + 1}": np.repeat(rows.side[own, i].astype(int), len(points)) for i in range(robot.n)}
        table |= {f"px_{axis}_mm": np.tile(1e3 * points[:, i], len(own)) for i, axis in enumerate("xyz")}
        table |= {"marker": view.name} if len(cell.hands) > 1 else {}
        table |= {"u_px": np.round(shown[:, 0], 4), "v_px": np.round(shown[:, 1], 4)}
        file = f"images{v + 1}.csv"
        pd.DataFrame(table).to_csv(folder / file, index=False)
        on = [_link(names, link, robot.n) for link in (view.camera_on, view.target_on)]
        head = "[[measurements]]" + (f'\nname = "images of {view.name}"' if view.name else "")
        text += f'\n{head}\nfile = "{file}"\nkind = "camera"\n' + (f"sigma_px = {SIGMA}\n" if stated else "")
        text += (
            f'[measurements.settings]\ncamera_on = "{on[0]}"\ntarget_on = "{on[1]}"\nsize_px = {_list(SIZE)}\n{lens}'
        )
    (folder / "study.toml").write_text(text, encoding="utf-8")


def _link(names: dict[int, str], link: int, last: int) -> str:
    return "world" if not link else names.get(link, "tool" if link == last else f"link{link}")


def _list(values: object) -> str:
    return "[" + ", ".join(f"{value:.12g}" for value in np.asarray(values, float)) + "]"


@dataclass(frozen=True)
class There:
    """Where a robot's hands really are at new poses, and where its maker says."""

    q: Array
    side: Array
    true: dict[str, Array]
    nominal: dict[str, tuple[Array, Array]]

    @staticmethod
    def of(cell: Cell, real: Cell, h: Hidden, rng: np.random.Generator) -> There:
        """Draw poses all over the joints' ranges."""
        q = rng.uniform(*cell.robot.limits.T, (NEW, cell.robot.n))
        side = rng.choice([-1.0, 1.0], q.shape)
        off = h.moved(real, q, side)
        true = {name: hand_points(real, q, hand, TOOL, off)[0] for name, hand in cell.hands.items()}
        return There(q, side, true, {name: hand_points(cell, q, hand, TOOL) for name, hand in cell.hands.items()})

    def missed(self, calibration: cf.Calibration) -> Row:
        """Root mean square errors of the calibrated robot and of its maker's figures, base and tool taught [mm]; the promise."""
        found, off = [], []
        for name, true in self.true.items():
            data = cf.Measurements.from_arrays(
                calibration.model.robot, self.q, None, marker=[name] * NEW, approach=self.side
            )
            model, (points, turned) = replace(calibration.model, given=data.given), self.nominal[name]
            there = model.point(calibration.estimate, data.conditions)
            found.append(untaught(there - true, points, turned))
            off.append(untaught(points - true, points, turned))
        rows = calibration.in_space
        promised = next(row for row in rows if row.where == RANGES and row.model != ALONE)
        return {
            "found_mm": _rms(found),
            "nominal_mm": _rms(off),
            "promised_mm": promised.rms_mm,
            "better": promised.better,
            "said": is_no_better(rows),
            "warned": bool(calibration.warnings),
        } | _of_images(rows)


def _of_images(rows: list[SpaceError]) -> Row:
    held = {row.model: row.rms_mm for row in rows if row.where == "holdout"}
    return {"images_alone_mm": held.get(ALONE), "images_mm": [*held.values()][-1] if held else None}


def _rms(errors: list[Array]) -> float:
    return 1e3 * float(np.sqrt(np.mean([(one**2).sum(axis=1).mean() for one in errors])))


def intervals(calibration: cf.Calibration, cell: Cell, real: Cell, alone: Array) -> Row:
    """How many of the geometry's and the lens's figures lie in their 95 % intervals, of those that no others stand for."""
    wrong, told = real.robot.figures - cell.robot.figures, dict(zip(figures(cell), alone, strict=True))
    mine = {(one.kind, one.of, one.at) for one, kept in told.items() if kept}
    lens = dict(zip(LENS, (*real.lens.focal, *real.lens.centre, *real.lens.bend), strict=True))
    inside: dict[str, list[bool]] = {"geometry": [], "lens": []}
    for k, parameter in enumerate(calibration.model.parameters):
        sd = np.sqrt(calibration.covariance[k, k])
        if parameter.effect == "camera" and parameter.symbol in lens:
            truth, kind = lens[parameter.symbol] - parameter.figure, "lens"
        elif parameter.effect == "geometry" and ("dh", parameter.joint - 1, _at(parameter.symbol)) in mine:
            truth, kind = wrong[parameter.joint - 1, DH.index(parameter.symbol)], "geometry"
        else:
            continue
        inside[kind].append(bool(abs(calibration.estimate[k] - truth) < NORMAL * sd))
    return {f"{kind}_n": len(own) for kind, own in inside.items()} | {
        f"{kind}_in": sum(own) for kind, own in inside.items()
    }


def _at(symbol: str) -> int:
    return DH.index(symbol) if symbol in DH else -1


def identified(folder: Path) -> cf.Calibration:
    """What a study's images identify."""
    study = cf.load_study(folder / "study.toml")
    return cf.identify(study.robot, study.measurements(), study.file.effects, starts=1, seed=study.file.seed)


def case(place: Place, cells: Sequence[Cell] = (CELLS["ur5e"], CELLS["panda"])) -> list[Row]:
    """Draw a robot, hide a cause or nothing, and hold what is found and promised against it."""
    rng, number = place.rng, place.number
    cell = cells[number % len(cells)]
    causes = [cause for cause in ALIKE if cause != "camera-slip" or len(cell.views) == 1]
    cause = "" if number // len(cells) % NULLS == NULLS - 1 else str(rng.choice(causes))
    rows = poses(cell, 80 if len(cell.views) > 1 else 60, rng)
    real, limits = worn(cell, rng), float(rng.choice(LIMITS))
    h, at = placed(real, rows, limits, cause, rng) if cause else (Hidden("", 0, 0.0, 0.0, 0), 0.0)
    seen = h.shown(real, rows)
    seen = seen + SIGMA * rng.standard_normal(seen.shape)
    known: Row = {
        "robot": cell.name,
        "cause": cause,
        "joint": h.joint,
        "size": h.size,
        "limits": limits,
        "at_limits": at,
    }
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, cell, rows, seen, rng)
        first = identified(folder)
        last = first.diagnose()
    there, alone = There.of(cell, real, h, rng), told_alone(slopes(real, rows))
    before = {f"before_{name}": value for name, value in there.missed(first).items()}
    return [known | there.missed(last) | before | intervals(last, cell, real, alone) | called(h, last)]


def two_arms(place: Place) -> list[Row]:
    """The same of two arms before a camera on a head."""
    return case(place, [cell for cell in CELLS.values() if len(cell.hands) > 1])


def worn(cell: Cell, rng: np.random.Generator) -> Cell:
    """The cell with its robot as built."""
    return Cell(**(vars(cell) | {"robot": cell.robot.worn(rng)}))


def called(h: Hidden, calibration: cf.Calibration) -> Row:
    """What is named, and whether it is what is hidden."""
    names = names_of(calibration)
    right = [h.may_be_called(row["cause"], joint_of(row)) for _, row in names.iterrows()]
    rivals = [any(h.may_be_called(*rival) for rival in rivals_of(row)) for _, row in names.iterrows()]
    findings = calibration.findings.table
    return {
        "in_set": any(right) or any(rivals), "in_class": any(right), "other_names": len(right) - sum(right),
        "certain_and_wrong": any(status == "named" and not yes for yes, status in zip(right, names["status"], strict=True)),
        "unexplained": int((findings["status"] == "unexplained").sum()),
        "faults": int((findings["status"] == "data_fault").sum()),
        "names": ";".join(f"{row['cause']}:{joint_of(row)}:{row['status']}" for _, row in names.iterrows()),
    }  # fmt: skip


def bad_plan(place: Place) -> list[Row]:
    """Draw few images, a narrow view, a wrong lens or some of these, and see whether a tool worse than nominal is said."""
    return planned(place, BAD_PLANS[place.number // 2 % len(BAD_PLANS)])


def good_plan(place: Place) -> list[Row]:
    """Draw many images from all sides, the lens unknown or stated as it is, and see how often that is told for no better."""
    return planned(place, GOOD_PLANS[place.number // 2 % len(GOOD_PLANS)])


def planned(place: Place, plans: Sequence[str]) -> list[Row]:
    """Draw a robot and images of a plan, calibrate it, and hold what is said of its tool against what that errs by."""
    rng, number = place.rng, place.number
    cell = [CELLS["ur5e"], CELLS["panda"]][number % 2]
    many = int(rng.integers(*FEW)) if "few" in plans else int(rng.integers(20, 50))
    near = float(rng.uniform(*NARROW)) if "narrow" in plans else np.inf
    rows = poses(cell, many, rng, near=near)
    errors = rng.choice([1.0, 0.3]) * np.array([1e-3, 5e-4])
    real, lens = Cell(**(vars(cell) | {"robot": cell.robot.worn(rng, *errors)})), ""
    if "lens" in plans:
        factor = 1 + rng.choice([-1, 1]) * rng.uniform(*FOCAL_WRONG)
        lens = stated_lens(factor * np.array(real.lens.focal), SIZE / 2, [0.0])
    if "known" in plans:
        lens = stated_lens(real.lens.focal, real.lens.centre, real.lens.bend)
    seen = images(real, rows) + SIGMA * rng.standard_normal((len(rows), len(board()), 2))
    known: Row = {"robot": cell.name, "plan": "+".join(plans), "images": many, "near": near}
    none = Hidden("", 0, 0.0, 0.0, 0)
    there = There.of(cell, real, none, rng)
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, cell, rows, seen, rng, lens)
        try:
            stages = {"identify": identified(folder)}
            if number % DIAGNOSED == 0:
                stages["diagnose"] = stages["identify"].diagnose()
        except cf.InputError as error:
            return [known | {"refused": str(error)}]
    return [known | {"stage": name, "refused": None} | there.missed(one) for name, one in stages.items()]


def stated_lens(focal: Sequence[float], centre: Sequence[float], bend: Sequence[float]) -> str:
    """A lens as a study states it."""
    return f"focal_px = {_list(focal)}\ncentre_px = {_list(centre)}\ndistortion = {_list(bend)}\n"


@dataclass(frozen=True)
class Information:
    """What images tell of a model's parameters, by derivatives in numpy, beside the model's priors: names (n,), priors' sd (n,)."""

    names: tuple[str, ...]
    columns: tuple[int, ...]
    prior_sd: Array

    @staticmethod
    def of(calibration: cf.Calibration, cell: Cell) -> Information:
        """Take those parameters that are figures of the cell, under the same priors."""
        at = {figure: k for k, figure in enumerate(figures(cell))}
        kept = []
        for parameter in calibration.model.parameters:
            symbol, joint = parameter.symbol, parameter.joint - 1
            figure = (
                Figure("beta", joint, 0) if symbol == "beta"
                else Figure("dh", joint, DH.index(symbol)) if parameter.effect == "geometry" and symbol in DH
                else Figure("lens", 0, LENS.index(symbol)) if symbol in LENS
                else Figure(parameter.part, 0, PLACE.index(symbol)) if parameter.part in ("camera", "target") else None
            )  # fmt: skip
            if figure is not None:
                kept.append((parameter.name, at[figure], parameter.prior_sd))
        names, columns, sd = zip(*kept, strict=True)
        return Information(names, columns, np.array(sd))

    def seen(self, cell: Cell, rows: Rows) -> Array:
        """What each image tells, (images, n, n), in units of the priors."""
        slope = (slopes(cell, rows)[:, self.columns] * self.prior_sd / SIGMA).reshape(len(rows), -1, len(self.names))
        return np.asarray(slope.transpose(0, 2, 1) @ slope)

    def sd(self, seen: Array, known: Sequence[str] = ()) -> float:
        """How unsure the shoulder's zero is [rad], and is where some parameters are known."""
        free = [k for k, name in enumerate(self.names) if name not in known]
        own = free.index(self.names.index(f"joint{SHOULDER}.theta"))
        covariance = np.linalg.inv((seen.sum(axis=0) + np.eye(len(self.names)))[np.ix_(free, free)])
        return float(self.prior_sd[free[own]] * np.sqrt(covariance[own, own]))


def look_alike(place: Place) -> list[Row]:
    """Draw few images that hardly tell a shoulder's zero, see whether its look-alikes are told, and what further poses do."""
    rng, number = place.rng, place.number
    cell = [CELLS["ur5e"], CELLS["panda"]][number % 2]
    near, many = float(rng.uniform(*NARROW)), int(rng.integers(8, 20))
    rows, choice = poses(cell, many, rng, near=near), poses(cell, MANY, rng)
    off = np.zeros(cell.robot.figures.shape)
    off[SHOULDER - 1, DH.index("theta")] = ZERO
    tree = cell.robot.worn(rng, 1e-4, 5e-5)
    real = replace(cell, robot=replace(tree, figures=tree.figures + off))
    seen = images(real, rows) + SIGMA * rng.standard_normal((len(rows), len(board()), 2))
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, cell, rows, seen, rng)
        calibration = identified(folder)
        proposed = next_poses(cf.load_study(folder / "study.toml"), FURTHER).poses
        q = np.radians(proposed[[f"q{i + 1}_deg" for i in range(cell.robot.n)]].to_numpy())
        further = Rows(q, np.ones_like(q), np.zeros(len(q), int))
        shown = images(real, further)
        whole = ((shown > 0) & (shown < SIZE)).all(axis=(1, 2))
        shown = shown[whole] + SIGMA * rng.standard_normal(shown[whole].shape)
        together = [np.concatenate(pair) for pair in ((rows.q, q[whole]), (rows.side, further.side[whole]))]
        both = Rows(*together, np.zeros(len(together[0]), int))
        write_study(folder / "measured", cell, both, np.concatenate([seen, shown]), rng)
        measured = identified(folder / "measured")
    known = Information.of(calibration, cell)
    first, every = known.seen(cell, rows), known.seen(cell, choice)
    best = [first.sum(axis=0)]
    for _ in range(FURTHER):
        sure = [known.sd(np.stack([*best, one])) for one in every]
        best.append(every[int(np.argmin(sure))])
    before = known.sd(first)
    mine = _sets_of_zero(calibration)
    truth = (real.robot.figures - cell.robot.figures)[SHOULDER - 1, DH.index("theta")]
    told: Row = {"still_told": bool(_sets_of_zero(measured))}
    for stage, one in {"first": calibration, "measured": measured}.items():
        zero = one.parameters[f"joint{SHOULDER}.theta"]
        told |= {f"{stage}_sd_mrad": 1e3 * zero.sd, f"{stage}_off_mrad": 1e3 * (zero.value - truth)}
    for group, names in ALIKE_GROUPS.items():
        told[f"{group}_alike"] = known.sd(first, names) < np.sqrt(0.5) * before
        told[f"{group}_told"] = any(one & {*names} for one in mine)
    return [{"robot": cell.name, "images": many, "near": near, "zero_mrad": 1e3 * before, "told": bool(mine),
             "next_mrad": 1e3 * known.sd(np.concatenate([first, known.seen(cell, further)[whole]])),
             "best_mrad": 1e3 * known.sd(np.stack(best)), "whole": int(whole.sum()), "proposed": len(q)} | told]  # fmt: skip


def _sets_of_zero(calibration: cf.Calibration) -> list[set[str]]:
    """The sets of parameters that the images do not tell apart, of those with the shoulder's zero."""
    table = calibration.results.tables["identify/identifiability.csv"]
    sets = [set(str(names).split(";")) for names in table["parameters"]]
    return [names for names in sets if f"joint{SHOULDER}.theta" in names]


def tell_look_alikes(cases: pd.DataFrame) -> str:
    """Which look-alikes are told as a set, and which the proposed poses part."""
    unsure = cases[cases["zero_mrad"] > UNSURE]
    parts = [f"the zero hardly told in {len(unsure)} of {len(cases)}, said of {int(unsure['told'].sum())}"]
    for group in ALIKE_GROUPS:
        alike = unsure[unsure[f"{group}_alike"].astype(bool)]
        parts.append(
            f"{group} look like it in {len(alike)}, told in one statement in {int(alike[f'{group}_told'].sum())}"
        )
    can = cases[cases["best_mrad"] < 0.5 * cases["zero_mrad"]]
    apart = can["next_mrad"] < 0.5 * can["zero_mrad"]
    parts.append(
        f"poses can part it in {len(can)}, those proposed do in {apart.mean():.3f} of these; sd before, after, after the best "
        f"(median): {cases['zero_mrad'].median():.3f}, {cases['next_mrad'].median():.3f}, {cases['best_mrad'].median():.3f} mrad; "
        f"whole board in {int(cases['whole'].sum())} of {int(cases['proposed'].sum())} images"
    )
    sure = can["measured_sd_mrad"] < 0.5 * can["first_sd_mrad"]
    near = can["measured_off_mrad"].abs() < 3 * can["measured_sd_mrad"]
    parts.append(
        f"measured there, the zero is twice as sure in {sure.mean():.3f} of these and within 3 sd in {near.mean():.3f}, "
        f"a set with others in {int(can['told'].sum())} before and {int(can['still_told'].sum())} after; off by (rms) "
        + ", ".join(f"{np.sqrt((can[f'{stage}_off_mrad'] ** 2).mean()):.3f}" for stage in ("first", "measured"))
        + " mrad before, after"
    )
    return "\n".join(parts)


def tell(cases: pd.DataFrame) -> str:
    """The promise, intervals, names and nulls."""
    none = cases["cause"].fillna("") == ""  # of cases just run, and of those read from a file
    hidden, nulls = cases[~none], cases[none]
    parts = [_promise(cases, "robot", ""), _promise(cases, "robot", "before_")]
    shares = {kind: cases[f"{kind}_in"].sum() / cases[f"{kind}_n"].sum() for kind in ("geometry", "lens")}
    parts.append(
        "in 95 % intervals: "
        + ", ".join(f"{kind} {100 * share:.1f} % of {cases[f'{kind}_n'].sum()}" for kind, share in shares.items())
    )
    for key in ("robot", "limits", "cause") if len(hidden) else ():
        named = hidden[["in_set", "in_class", "certain_and_wrong", "unexplained", "other_names"]].astype(float)
        parts.append(named.groupby(hidden[key]).mean().round(3).assign(n=hidden.groupby(key).size()).to_string())
    if len(hidden):
        parts.append(
            f"in the set {hidden['in_set'].mean():.3f} of {len(hidden)}, certain and wrong {hidden['certain_and_wrong'].mean():.3f}"
        )
    if len(nulls):
        parts.append(
            f"nothing hidden: a cause named in {int((nulls['other_names'] > 0).sum())} of {len(nulls)}, "
            f"unexplained in {int((nulls['unexplained'] > 0).sum())}"
        )
    return "\n\n".join(parts)


def _promise(cases: pd.DataFrame, key: str, stage: str) -> str:
    found, promised, off = (cases[f"{stage}{name}_mm"] for name in ("found", "promised", "nominal"))
    table = pd.DataFrame({
        "found": (found**2).groupby(cases[key]).mean() ** 0.5, "promised": (promised**2).groupby(cases[key]).mean() ** 0.5,
        "nominal": (off**2).groupby(cases[key]).mean() ** 0.5, "worst": (found / promised).groupby(cases[key]).max(),
        "above_1.3": (found > 1.3 * promised).groupby(cases[key]).mean(),
    })  # fmt: skip
    whole = np.sqrt((found**2).sum() / (promised**2).sum())
    title = "geometry alone" if stage else "with causes"
    return f"{title} [mm]\n{table.round(3).to_string()}\nfound over promised, all: {whole:.3f}"


def tell_plans(cases: pd.DataFrame) -> str:
    """Which calibrations are worse than nominal, and of which it is said."""
    done = cases[cases["refused"].isna()].assign(worse=lambda rows: rows["found_mm"] > rows["nominal_mm"])
    done = done.assign(
        unsaid=done["worse"] & ~done["said"].astype(bool), needless=~done["worse"] & done["said"].astype(bool)
    )
    table = (
        done.groupby(["stage", "plan"])[["worse", "said", "unsaid", "needless"]]
        .sum()
        .assign(n=done.groupby(["stage", "plan"]).size())
    )
    refused, unsaid, worse = (
        int(n) for n in (cases["refused"].notna().sum(), done["unsaid"].sum(), done["worse"].sum())
    )
    first = done[done["stage"] == "identify"]
    stated = kept_cases.calibration_table(first["better"], ~first["worse"], STATED)
    return f"{table.to_string()}\nrefused {refused}, unsaid {unsaid} of {worse} worse\nidentified, nearer:\n{stated}"


if __name__ == "__main__":
    kept_cases.run_cases(
        __doc__,
        {
            "cases": (case, tell),
            "two_arms": (two_arms, tell),
            "bad_plans": (bad_plan, tell_plans),
            "good_plans": (good_plan, tell_plans),
            "look_alikes": (look_alike, tell_look_alikes),
        },
    )
