"""The measuring loop on hidden robots: whether it stops where the tolerance is truly met, and with how many poses.

    python benchmarks/loop.py loop 60     the loop
    python benchmarks/loop.py foreign 40  the loop on arms of foreign_physics.py, in turn
    python benchmarks/loop.py plan 60     fixed plans for other cases of the same kinds as those of loop

The HH800 under its rated load as built (tests/hidden/): dimensions and springs off, 0.03 mm noise per axis, which the study states.
Every other case hides besides one or two causes at 1 to 30 % of the catalogue's largest size, or a smooth background that no
catalogue has, at 0.3 to 3 times the noise. The tolerance of the rms error over the task is 0.6 to 2.5 times the noise. The loop
looks after 20 poses, and each time after about a fifth more, up to 110; it gives up there, or from 43 on where more poses of the
kind would hardly do. What it stops with is held against the real tool at 400 fresh poses of the task. Of foreign arms causes are
forms of foreign_forms.py, of 0.5 to 5 limits of 40 poses, and candidates and task are files of their poses.

Poses suffice at the first look at which the tool is truly within: nobody knows that then. A tool is sure at the first look at which
its parameters' covariance alone says so with the probability asked for: of a robot that lacks nothing nobody honest stops before.

A fixed plan is chosen before anything is measured: the O1 plan (`select` with the criterion parameters) of the least of these
sizes, or 160, at which the standard deviation that select expects of the tool over the task is a factor below the tolerance.
The factor is the least at which 95 % of the cases meet their tolerance, of those that 160 such poses calibrate well enough; each
is diagnosed as the loop does. --out FILE.csv keeps the single cases.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Protocol

import blind_cases as cases
import numpy as np
import pandas as pd
from blind_cases import Job, Unit
from blind_run import Kind, Row, guarded, run_kind
from foreign_forms import FORMS
from foreign_forms import Hidden as Form
from foreign_forms import measured as foreign_points
from foreign_physics import ARMS, Arm, measured_rows
from foreign_physics import PAYLOADS as LOADS
from foreign_physics import Rows as ForeignRows
from foreign_physics import worn as foreign_worn
from foreign_study import robot_toml
from other_forms import World, placed

import calflow as cf
from calflow.design.next_poses import CONFIDENCE
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.model import Model
from calflow.runs.run import run
from calflow.stages.measuring_loop import next_poses
from calflow.study import load_study
from hidden.backgrounds import KINDS as BACKGROUNDS
from hidden.case import COMPLIANCE, Case, draw_poses, robot_file, stated_tables, toml
from hidden.causes import PAYLOADS, Hidden, measured_points
from hidden.simulator import Robot, Rows, read, worn

NOISE = 3e-5  # m, per axis
TOLERANCES = 0.6, 2.5  # of a case, over the noise
LOOKS = (20, 25, 30, 36, 43, 52, 62, 75, 90, 110)  # poses
PLANS = (20, 30, 45, 60, 80, 110, 160)
FACTORS = tuple(k / 10 for k in range(8, 26))
BINS = (-1e-9, 0.05, 0.5, 0.8, 0.95, 1.0)  # of a probability
HOPELESS, TRIED = 0.2, 43  # probability at best, and poses from which it is heeded
FRESH = 400
SIZES = 0.01, 0.3  # of a cause, over the catalogue's largest
BACKGROUND = 0.3, 3.0  # of a background, over the noise
FIELDS = ("joints", "shared")  # backgrounds that are functions of a row alone
N_CAUSES = {"cause": 1, "two causes": 2}  # of a kind of case
FORM_LIMITS, WAVES = (0.5, 5.0), 200
UNITS = tuple(
    unit for unit in cases.UNITS
    if unit.cause in ("joint-backlash", "joint-eccentricity", "periodic-joint-error", "gear-ratio-error", "bearing-compliance",
                      "link-bending", "link-torsion", "base-compliance", "tool-deflection")
)  # fmt: skip
STUDY = """\
name = "loop"
robot = "robot.toml"
workflow = "calibrate"
seed = {seed}
effects = ["geometry", "joint-compliance"]
{measurements}
[split]
holdout = 0

[stages.identify]
starts = 1

[stages.select]
poses = {poses}
payload = "full"
sigma_mm = {sigma}
criterion = "{criterion}"
{where}
"""
WHERE = """\
candidates = 600
region_min_m = [1.5, -1.6, 0.5]
region_max_m = [3.6, 1.6, 3.0]

[stages.select.task]
payloads = ["full"]
number = 150
"""
FILES = 'candidates_file = "candidates.csv"\n\n[stages.select.task]\nposes = "task.csv"\n'
MEASURED = '[measurements]\nfile = "measurements.csv"\nsigma_mm = {sigma}\n'


class Cell(Protocol):
    """A real robot in its cell, which is programmed with poses and measured."""

    @property
    def noise(self) -> float:
        """The device's, per axis [m]."""
        ...

    @property
    def hidden_words(self) -> str:
        """What its model does not have."""
        ...

    @property
    def slides(self) -> np.ndarray:
        """Which joints are slides (n_joints,)."""
        ...

    def write(self, folder: Path) -> str:
        """Write the robot's file, and say where the study's poses are to be chosen, and its task."""
        ...

    def fresh(self, number: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return readings (number, n_joints) anywhere in the task, and the sides that joints come from."""
        ...

    def points(self, q: np.ndarray, sides: np.ndarray) -> np.ndarray:
        """Where the tool is, without noise (n, 3) [m]."""
        ...


@dataclass(frozen=True)
class Hh800:
    """The HH800 as built."""

    stated: Robot
    real: Robot
    tables: dict
    hidden: tuple[Hidden, ...]
    field: tuple[str, float, int] | None
    noise: float = NOISE
    slides: np.ndarray = field(default_factory=lambda: np.zeros(6, dtype=bool))

    @staticmethod
    def drawn(job: Job) -> Hh800:
        """Build the robot of a case."""
        rng = np.random.default_rng([job.seed, 1])
        tables = stated_tables(Case(robot="hh800"))
        stated = read(tables, np.array(COMPLIANCE["hh800"]))
        real = worn(stated, rng)
        hidden = tuple(_cause(rng) for _ in range(N_CAUSES.get(job.kind, 0)))
        size = NOISE * float(np.exp(rng.uniform(*np.log(BACKGROUND))))
        background = (str(rng.choice(FIELDS)), size, int(rng.integers(2**32))) if job.kind == "background" else None
        return Hh800(stated, real, tables, hidden, background)

    @property
    def hidden_words(self) -> str:
        return "; ".join(f"{h.cause} {h.joint} {h.size:.2g}" for h in self.hidden) or str(self.field or "")

    def write(self, folder: Path) -> str:
        (folder / "robot.toml").write_text(toml(robot_file(self.tables, True)), encoding="utf-8")
        return WHERE

    def fresh(self, number: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        q = draw_poses(self.stated, Case(robot="hh800", poses=number), rng)
        return q, rng.choice([-1.0, 1.0], q.shape)

    def points(self, q: np.ndarray, sides: np.ndarray) -> np.ndarray:
        point = measured_points(self.real, _rows(q, sides), self.hidden)
        if self.field is None:
            return point
        kind, size, seed = self.field
        other, came = self.fresh(
            500, np.random.default_rng([seed, 1])
        )  # the same at every call: they say how large it is
        shift = BACKGROUNDS[kind](
            np.random.default_rng(seed), self.real, _rows(np.vstack([other, q]), np.vstack([came, sides]))
        )
        mean = shift[:500].mean(axis=0)
        return point + size * (shift[500:] - mean) / np.sqrt(np.mean((shift[:500] - mean) ** 2))


@dataclass(frozen=True)
class Foreign:
    """A worn arm of numpy's own, with forms that its joints and loads show, or a smooth background of three of its joints."""

    arm: Arm
    real: Arm
    noise: float
    hidden: tuple[Form, ...]
    waves: tuple[np.ndarray, np.ndarray, np.ndarray]

    @staticmethod
    def drawn(job: Job) -> Foreign:
        """Build the robot of a case."""
        rng, arm = np.random.default_rng([job.seed, 1]), ARMS[job.case.robot]
        noise, real = (
            float(rng.uniform(3e-5, 5e-5) if arm.name == "large-6" else rng.uniform(1.5e-5, 3e-5)),
            foreign_worn(arm, rng),
        )
        rows = measured_rows(arm, 40, rng, payloads=[LOADS.index("full")])
        world = World(arm, real, rows, np.zeros(0), noise * np.eye(len(rows)))
        forms = [form for form in FORMS if arm.name in form.arms and not form.needs]
        hidden = (
            placed(
                forms[int(rng.integers(len(forms)))], world, float(np.exp(rng.uniform(*np.log(FORM_LIMITS)))), True, rng
            )
            for _ in range(N_CAUSES.get(job.kind, 0))
        )
        size = noise * float(np.exp(rng.uniform(*np.log(BACKGROUND)))) * (job.kind == "background")
        # Waves whose directions are normal have the squared exponential for their correlation (Rahimi and Recht 2007).
        turned = rng.standard_normal((WAVES, arm.n)) / rng.uniform(0.7, 1.5)
        turned[:, rng.permutation(arm.n)[3:]] = 0.0
        waves = (
            turned / arm.span,
            rng.uniform(0, 2 * np.pi, WAVES),
            size * np.sqrt(2 / WAVES) * rng.standard_normal((WAVES, 3)),
        )
        return Foreign(arm, real, noise, tuple(one.hidden for one in hidden if one.hidden), waves)

    @property
    def slides(self) -> np.ndarray:
        return self.arm.slide

    @property
    def hidden_words(self) -> str:
        words = "; ".join(f"{h.form.cause} as {h.form.name} {h.joint} {h.size:.2g}" for h in self.hidden)
        size = float(np.sqrt((self.waves[2] ** 2).sum() / 6))
        return words or (f"background {1e3 * size:.2g} mm" if size else "")

    def write(self, folder: Path) -> str:
        (folder / "robot.toml").write_text(robot_toml(self.arm, masses=True, markers=1), encoding="utf-8")
        for name, number in (("candidates", 600), ("task", 150)):
            q, _ = self.fresh(number, np.random.default_rng([number]))
            columns = _columns(self.slides)
            pd.DataFrame(_shown(q, self.slides), columns=columns).to_csv(folder / f"{name}.csv", index=False)
        return FILES

    def fresh(self, number: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        rows = measured_rows(self.arm, number, rng)
        return rows.q, rows.side

    def points(self, q: np.ndarray, sides: np.ndarray) -> np.ndarray:
        n, none = len(q), np.zeros(len(q), dtype=int)
        travel = np.full(q.shape, 0.1 * self.arm.span)
        way = np.stack([q, q - sides * travel, q], axis=1)
        rows = ForeignRows(
            q, np.full(n, LOADS.index("full")), none, np.arange(n), sides, travel, way, 0.0 * none, 21.0 + none, none
        )
        turned, phase, moved = self.waves
        return foreign_points(self.real, rows, self.hidden) + np.cos(q @ turned.T + phase) @ moved


def _columns(slides: np.ndarray) -> list[str]:
    return [f"q{i}_{'mm' if slide else 'deg'}" for i, slide in enumerate(slides, start=1)]


def _shown(q: np.ndarray, slides: np.ndarray) -> np.ndarray:
    return q * np.where(slides, 1e3, np.rad2deg(1.0))


def _measured(cell: Cell, poses: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """A file of poses with what the tracker saw filled in."""
    q = poses[_columns(cell.slides)].to_numpy() / _shown(np.ones(len(cell.slides)), cell.slides)
    sides = poses[[f"approach{i + 1}" for i in range(len(cell.slides))]].to_numpy(float)
    seen = cell.points(q, sides) + cell.noise * rng.standard_normal((len(q), 3))
    kept = [name for name in poses if not name.startswith("nominal") and name != "reason"]
    return poses[kept].assign(**dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * seen.T, strict=True)))


def _cause(rng: np.random.Generator) -> Hidden:
    unit: Unit = UNITS[rng.integers(len(UNITS))]
    size = unit.largest * float(np.exp(rng.uniform(*np.log(SIZES))))
    extra = unit.extras[rng.integers(len(unit.extras))]
    return Hidden(unit.cause, int(rng.choice(unit.joints)), size, extra, int(rng.integers(2**32)))


def _rows(q: np.ndarray, sides: np.ndarray) -> Rows:
    n, none = len(q), np.zeros_like(q)
    return Rows(
        q, np.full(n, PAYLOADS.index("full")), np.zeros(n, int), sides, none, none, np.zeros(n), np.full(n, 20.0)
    )


KINDS = ("nothing", "cause", "nothing", "background", "nothing", "two causes", "nothing", "background")


def jobs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Nothing hidden in every other case; in the others one cause, a background, two causes, a background."""
    return _jobs(number, rng, ["hh800"])


def foreign_jobs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """The same of foreign arms, each of which has every kind in turn."""
    return _jobs(number, rng, list(ARMS))


def _jobs(number: int, rng: np.random.Generator, robots: list[str]) -> Iterator[Job]:
    for k in range(number):
        tolerance = float(np.exp(rng.uniform(*np.log(TOLERANCES))))
        robot = robots[(k + k // len(KINDS)) % len(robots)]
        yield Job(Case(robot=robot, sigma=NOISE), cases.new_seed(rng), KINDS[k % len(KINDS)], tolerance)


def by_loop(job: Job) -> Row:
    """Measure until the loop says stop."""
    return guarded(lambda folder: looped(cell_of(job), job, folder), job)


def by_plan(job: Job) -> Row:
    """Measure by fixed plans."""
    return guarded(lambda folder: planned(cell_of(job), job, folder), job)


def cell_of(job: Job) -> Cell:
    """The robot of a case in its cell."""
    return Foreign.drawn(job) if job.case.robot in ARMS else Hh800.drawn(job)


def looped(cell: Cell, job: Job, folder: Path) -> Row:
    """Go round the loop."""
    rng, tolerance = np.random.default_rng([job.seed, 2]), job.size * cell.noise
    _study(folder, cell, job.seed, measured=False)
    poses = next_poses(load_study(folder), LOOKS[0], tolerance).poses
    said, true, sure = [], [], []
    for number, following in zip(LOOKS, (*LOOKS[1:], LOOKS[-1] + 1), strict=True):
        _append(folder, _measured(cell, poses, rng))
        _study(folder, cell, job.seed, measured=True)
        step = next_poses(load_study(folder), following - number, tolerance)
        assert step.calibrated is not None
        said.append(step.verdict)
        true.append(true_error(cell, step.calibrated, job.seed))
        sure.append(by_parameters(cell, step.calibrated, job.seed))
        hopeless = number >= TRIED and (step.verdict.probability_at_best or 0.0) < HOPELESS
        if step.verdict.status == "stop" or hopeless:
            break
        poses = step.poses
    last = said[-1]

    def first(errors: list[float]) -> int | None:
        return next((one.poses for one, error in zip(said, errors, strict=True) if error <= tolerance), None)

    return {
        "hidden": cell.hidden_words, "tolerance_mm": 1e3 * tolerance, "stopped": last.status == "stop", "poses": last.poses,
        "sufficed": first(true), "sure": first(sure), "probability": last.probability, "at_best": last.probability_at_best,
        "true_mm": 1e3 * true[-1], "met": bool(true[-1] <= tolerance), "found": len(last.found), "median_mm": last.error_mm,
        "most_mm": last.error_most_mm,
        "looks": ";".join(
            f"{one.poses}:{one.probability:.3f}:{one.error_mm:.4f}:{1e3 * t:.4f}"
            for one, t in zip(said, true, strict=True)
        ),
    }  # fmt: skip


def planned(cell: Cell, job: Job, folder: Path) -> Row:
    """Calibrate by the fixed plans that any factor asks for, and by the largest."""
    row: Row = {"hidden": cell.hidden_words, "tolerance_mm": 1e3 * job.size * cell.noise}
    asked = {planned_size(1e3 * job.size * cell.noise, factor) for factor in FACTORS}
    for number in sorted(asked | {PLANS[-1]}):
        own, rng = folder / f"plan{number}", np.random.default_rng([job.seed, 3, number])
        own.mkdir()
        poses, _ = fixed_plan(number)
        _append(own, _measured(cell, poses, rng))
        _study(own, cell, job.seed, measured=True)
        study = load_study(own)
        found = cf.identify(study.robot, study.measurements(), study.file.effects, starts=1)
        extended = found.diagnose()
        row[f"plan{number}_mm"] = 1e3 * true_error(cell, extended, job.seed)
    return row


@cache
def fixed_plan(number: int) -> tuple[pd.DataFrame, float]:
    """The O1 plan of so many poses, the same for all cases, and the standard deviation that select expects of the tool [mm]."""
    cell = Hh800.drawn(Job(Case(robot="hh800"), 1, "nothing", 1.0))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _study(folder, cell, 1, measured=False, poses=number, criterion="parameters")
        results = run(load_study(folder), folder / "run", stage="select").results
        return results.tables["select/poses.csv"], results.documents["select/how_many.json"]["expected_sd_mm"]


def true_error(cell: Cell, known: CalibratedModel, seed: int) -> float:
    """Root mean square distance [m] of the real tool from the calibrated one at fresh poses of the task."""
    model, rows, (q, sides) = _fresh(cell, known, seed)
    off = model.point(known.estimate, rows.conditions) - cell.points(q, sides)
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def by_parameters(cell: Cell, known: CalibratedModel, seed: int) -> float:
    """What the same is below with the probability asked for, by the covariance of the parameters alone [m]."""
    model, rows, _ = _fresh(cell, known, seed)
    variance = known.covariance
    slope = model.point_jacobian(known.estimate, rows.conditions)
    drawn = np.random.default_rng([seed, 5]).multivariate_normal(np.zeros(len(variance)), variance, 1000, method="eigh")
    mean_square = np.einsum("nai,naj->ij", slope, slope) / len(slope)
    return float(np.sqrt(np.quantile(np.einsum("ki,ij,kj->k", drawn, mean_square, drawn), CONFIDENCE)))


def _fresh(
    cell: Cell, known: CalibratedModel, seed: int
) -> tuple[Model, cf.Measurements, tuple[np.ndarray, np.ndarray]]:
    q, sides = cell.fresh(FRESH, np.random.default_rng([seed, 4]))
    robot = known.model.robot
    rows = cf.Measurements.from_arrays(robot, q, None, payload="full", marker=next(iter(robot.markers)), approach=sides)
    return replace(known.model, given=rows.given), rows, (q, sides)


def _append(folder: Path, rows: pd.DataFrame) -> None:
    path = folder / "measurements.csv"
    rows.to_csv(path, mode="a", header=not path.exists(), index=False)


def _study(folder: Path, cell: Cell, seed: int, measured: bool, poses: int = 20, criterion: str = "tool") -> None:
    sigma = 1e3 * cell.noise
    text = STUDY.format(
        seed=seed % 1000, measurements=MEASURED.format(sigma=sigma) if measured else "", poses=poses, sigma=sigma,
        criterion=criterion, where=cell.write(folder),
    )  # fmt: skip
    (folder / "study.toml").write_text(text, encoding="utf-8")


def told_of_loop(rows: pd.DataFrame) -> str:
    """How often the loop stopped, whether rightly, and its poses against those of fixed plans by some factors."""
    every = pd.concat([rows, rows.assign(kind="all")])
    stopped = every[every["stopped"].astype(bool)].astype({"met": float, "probability": float, "poses": float})
    told = (
        every.astype({"stopped": float})
        .groupby("kind")
        .agg(n=("poses", "size"), stopped=("stopped", "mean"), found=("found", "mean"), seconds=("seconds", "median"))
    )
    right = stopped.groupby("kind").agg(
        met_at_stop=("met", "mean"), mean_probability=("probability", "mean"), poses=("poses", "mean")
    )
    own = stopped[stopped["kind"] == "all"]
    lines = [f"poses of the loop where it stopped: {own['poses'].mean():.1f}"]
    for kind, group in stopped.groupby("kind"):
        for what in ("sufficed", "sure"):
            there = group[group[what].notna()]
            ratio = there["poses"].sum() / max(there[what].astype(float).sum(), 1)
            lines.append(f"{kind}: {ratio:.2f} times the poses at which the tool {what}, of {len(there)}")
    if (rows["robot"] != "hh800").any():
        return "\n".join(
            (told.join(right).round(3).to_string(), "", by_probability(rows).round(3).to_string(), "", *lines)
        )
    for factor in FACTORS:
        sizes = [planned_size(tolerance, factor) for tolerance in own["tolerance_mm"]]
        lines.append(
            f"planned with factor {factor:.1f}: {np.mean(sizes):.1f}; the loop {own['poses'].mean() / np.mean(sizes):.2f} times"
        )
    return "\n".join((told.join(right).round(3).to_string(), "", by_probability(rows).round(3).to_string(), "", *lines))


def by_probability(rows: pd.DataFrame) -> pd.DataFrame:
    """What was said at all looks, those that did not stop as well, against how often the tool was truly within."""
    every = [
        (float(probability), float(true) <= tolerance)
        for looks, tolerance in zip(rows["looks"], rows["tolerance_mm"], strict=True)
        for _, probability, _, true in (look.split(":") for look in str(looks).split(";"))
    ]
    looks = pd.DataFrame(every, columns=["probability", "met"])
    return looks.groupby(pd.cut(looks["probability"], BINS), observed=True).agg(
        looks=("met", "size"), mean_probability=("probability", "mean"), met=("met", "mean")
    )


def told_of_plans(rows: pd.DataFrame) -> str:
    """How often tolerances are met by factor."""
    names = [f"plan{n}_mm" for n in PLANS]
    error, tolerance = rows.reindex(columns=names).to_numpy(float), rows["tolerance_mm"].to_numpy()
    reachable = error[:, -1] <= tolerance
    lines = [f"within reach of {PLANS[-1]} planned poses: {reachable.sum()} of {len(rows)} cases"]
    for factor in FACTORS:
        which = [PLANS.index(planned_size(one, factor)) for one in tolerance]
        met = (error[np.arange(len(rows)), which] <= tolerance)[reachable].mean()
        lines.append(f"factor {factor:.1f}: met in {met:.3f} of them, {np.mean(np.array(PLANS)[which]):.1f} poses")
    return "\n".join(lines)


def planned_size(tolerance: float, factor: float) -> int:
    """Return how many poses a fixed plan has for a tolerance [mm]."""
    return next((n for n in PLANS if factor * fixed_plan(n)[1] <= tolerance), PLANS[-1])


if __name__ == "__main__":
    kinds = {"loop": Kind(jobs, by_loop, told_of_loop), "foreign": Kind(foreign_jobs, by_loop, told_of_loop),
             "plan": Kind(jobs, by_plan, told_of_plans)}  # fmt: skip
    run_kind(__doc__, kinds)
