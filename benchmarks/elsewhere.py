"""Promises elsewhere and later: whether intervals of predictions hold where, and when, nothing was measured.

    python benchmarks/elsewhere.py real --cases 6          splits of measured robots (CALFLOW_DATA)
    python benchmarks/elsewhere.py simulated --cases 60    a third of the joint space measured, predicted in the rest
    python benchmarks/elsewhere.py forms --cases 40        the same of arms with a cause in another form than the catalogue's
    python benchmarks/elsewhere.py parameters --cases 300  intervals of parameters, and of plain least squares beside them
    python benchmarks/elsewhere.py later --cases 60        device and robot wander; predicted one hour and a day on
    python benchmarks/elsewhere.py later-otherwise         other forms of that

Simulated arms are of foreign_physics.py; joints err by smooth random functions of several joints' angles, rms 1 to 5 times the
noise at the tool, which no catalogue has; or a form of foreign_forms.py acts, at 5 limits (see other_forms.py). Real robots' base
and tool are placed anew where they are predicted: by 20 poses drawn there, the others judged, or by all. Intervals of what a
placement leaves are worked out from the promise: its parameters' part with their covariance, the device's noise for independent
from row to row, all else from standstill to standstill, whose markers share it as the calibration says. Worst is calibrated over
nominal (placed alike), rms, in the worst of eight regions; promise is the pooled standard deviation over the pooled error. `later`
tells of what the device sees then, without noise: a frame that walks at random (device), an arm that warms up and cools in pauses
(warm-up), or both; `later-otherwise` has joint zeros that go by its warmth, and a device whose scale about its stand walks; each
case is judged by CONTINUED walks after the same measurement. framed is what intervals cover where the device's frame is fitted anew
at that hour. The FANUC is split by joint 2: joint 1 stood still in all but three of its 24 poses. What is promised of a measurement
is of another one, in which the device wanders otherwise; both halves of UR5 and FANUC are of one, so that they are judged without
that as well (wander: this).

Beside what is covered of measured robots stands what chance gives, by draws of the errors from the promise itself, placed alike:
least is what it covers in 95 of 100 draws, chance the share of draws in which calibrated is worse than nominal by more than 5 % in
a region. Both are of single splits, and the mean where several are pooled: six splits of one robot's poses are no six robots.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import kept_cases
import numpy as np
import other_forms
import pandas as pd
from foreign_forms import DEVICE, FORMS, measured
from foreign_physics import ARMS, Arm, Array, Rows, Yielding, flange, likeness, measured_rows, points, worn
from foreign_study import identified, joint_of, names_of, predicted, write_study
from kept_cases import Place, Row
from real_data import DATA
from scipy import sparse
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.deployment.prediction import Prediction, predict_rows
from calflow.estimation.smooth_functions import Wandering
from calflow.measurements.measurements import Measurements
from calflow.study import load_study

WITHIN = 1.959964
PLACED_BY = 20  # poses of the new place
FEWEST = 3  # poses of a region to be judged
HARMED = 1.05  # calibrated over nominal
DRAWS = 200  # of what chance gives
HOUR = 3600.0

# --- What a promise is worth ---------------------------------------------------------------------------


def promised(error: Array, sd: Array, nominal: Array, place: Array, pose: Array) -> Row:
    """Compare errors (rows, 3) [m] with their standard deviations, and with the nominal robot's by region of the places."""
    inside = np.abs(error) < WITHIN * sd
    region = (place > np.median(place, axis=0)) @ [1, 2, 4]
    regions = [region == k for k in np.unique(region) if len(np.unique(pose[region == k])) >= FEWEST]
    by_axis = dict(zip(("covered_x", "covered_y", "covered_z"), inside.mean(axis=0), strict=True))
    sizes = {"promised_mm": 1e3 * _rms(sd), "found_mm": 1e3 * _rms(error), "nominal_mm": 1e3 * _rms(nominal)}
    worst = max((_rms(error[here]) / _rms(nominal[here]) for here in regions), default=np.nan)
    return {"covered": inside.mean(), **by_axis, "coordinates": error.size, **sizes, "worst": worst}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def tell_promises(rows: pd.DataFrame) -> str:
    """Coverage of all coordinates, promise over found, and how often calibrated is worse than nominal by more than 5 %."""
    keys = [
        name for name in ("split", "stage", "placed", "wander", "ahead_h") if name in rows and rows[name].notna().any()
    ]
    by_case = [_pooled(rows, ["case", "seed", *keys])] if rows["case"].nunique() <= 8 else []
    parts = [_pooled(rows, keys[1:] if "split" in keys else keys), *by_case]
    others = [name for name in ("converged", "told", "framed") if name in rows]
    if others:
        at = [name for name in keys if name in ("stage", "ahead_h")]
        parts.append(rows.groupby(at)[others].agg(lambda share: share.astype(float).mean()).round(3).to_string())
    return "\n\n".join(parts)


def _pooled(rows: pd.DataFrame, keys: list[str]) -> str:
    def of(group: pd.DataFrame) -> pd.Series:
        weight = group["coordinates"] / group["coordinates"].sum()
        share = {name: (group[name] * weight).sum() for name in ("covered", "covered_x", "covered_y", "covered_z")}
        sd, error = (np.sqrt((group[name] ** 2 * weight).sum()) for name in ("promised_mm", "found_mm"))
        chance = {name: (group[name] * weight).sum() for name in ("least", "chance") if name in group}
        return pd.Series(share | {"promise": sd / error, "found_mm": error, "worst": group["worst"].max(),
                                  "harmed": (group["worst"] > HARMED).mean()} | chance | {"rows": len(group)})  # fmt: skip

    return rows.groupby(keys, dropna=False).apply(of, include_groups=False).round(3).to_string()


def stages(first: cf.Calibration) -> dict[str, cf.Calibration]:
    """The calibration as identified and as diagnosed."""
    return {"identify": first, "diagnose": first.diagnose()}


# --- Measured robots -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Split:
    """A robot's rows here, to calibrate by, and there, to predict, and whether both are of one measurement."""

    name: str
    here: Measurements
    there: Measurements
    one_measurement: bool


def work_real(place: Place) -> list[Row]:
    """Calibrate in one place, predict in the other."""
    (name, way), rng = SPLITS[place.number % len(SPLITS)], place.rng
    split = _split(name, way)
    study = load_study(DATA[name.replace("ur10", "ur10-c")])
    data = split.here.split(holdout=0.2, seed=place.seed)
    first = cf.identify(study.robot, data, study.file.effects, starts=1, seed=place.seed)
    found = []
    wanders = ("another", "this") if split.one_measurement else ("another",)
    for (stage, known), placed in product(stages(first).items(), ("few", "all")):
        of_row = split.there.table["pose"].to_numpy()
        poses = np.unique(of_row)
        few = rng.choice(poses, min(PLACED_BY, len(poses) // 2), replace=False)
        used = np.isin(of_row, few if placed == "few" else poses)
        for wander in wanders:
            row: Row = {"split": split.name, "stage": stage, "placed": placed, "wander": wander}
            found.append(
                row | placed_anew(still(known) if wander == "this" else known, split.there, used, rng.spawn(1)[0])
            )
    return found


def still(known: cf.Calibration) -> cf.Calibration:
    """The calibration without what wanders from measurement to measurement: in its own one the causes say how."""
    return replace(known, errors=known.errors.only(lambda function: not isinstance(function, Wandering)))


SPLITS = tuple(product(("ur10", "ur5", "fanuc"), (False, True)))


def _split(name: str, back: bool) -> Split:
    if name == "ur10":
        c, b = (load_study(DATA[key]).measurements() for key in ("ur10-c", "ur10-b"))
        here, there = (_whole(data) for data in ((b, c) if back else (c, b)))
        return Split("ur10 B to C" if back else "ur10 C to B", here, there, False)
    data = load_study(DATA[name]).measurements()
    if name == "ur5":
        data = data.only(data.train)  # the grid
        far = np.linalg.norm(data.position - data.position.mean(axis=0), axis=1)
    else:
        far = data.joints[:, 1]
    beyond = far > np.median(far) if name == "ur5" else far > 0
    here, there = (_whole(data.only(which)) for which in ((beyond, ~beyond) if back else (~beyond, beyond)))
    names = {"ur5": ("inner to outer", "outer to inner"), "fanuc": ("joint 2 low to high", "joint 2 high to low")}[name]
    return Split(f"{name} {names[back]}", here, there, True)


def _whole(data: Measurements) -> Measurements:
    return replace(data, table=data.table.drop(columns="split", errors="ignore"))


def placed_anew(known: cf.Calibration, data: Measurements, used: Array, rng: np.random.Generator) -> Row:
    """Place base and markers by the rows used (rows,), and judge the others, or all where all are used."""
    data = data.on(known.model.robot).stating(known.model.given)
    prediction, measured = predict_rows(known, data, "widen"), data.position
    turn, marker = known.model.rotation(known.estimate, data.conditions), data.table["marker"].to_numpy()
    design, flat = _placing(prediction.position, turn, marker), np.repeat(used, 3)
    judged = flat if used.all() else ~flat
    fit, here = np.linalg.pinv(design[flat], rcond=1e-10), judged[::3]

    def left(moved: Array) -> Array:
        return moved[judged] - design[judged] @ (fit @ moved[flat])

    spread = known.shared_errors(data.conditions).reshape(len(design), -1)
    alone = _alone(known, data, np.maximum(prediction.sd**2 - (spread**2).sum(axis=1).reshape(-1, 3), 0))
    variance = (left(spread) ** 2).sum(axis=1)
    for columns in np.array_split(np.arange(alone.shape[1]), alone.shape[1] // 500 + 1):
        variance += (left(alone[:, columns].toarray()) ** 2).sum(axis=1)
    error, sd = left((prediction.position - measured).ravel()).reshape(-1, 3), np.sqrt(variance).reshape(-1, 3)
    nominal = _replaced(measured, known.model.point(known.model.nominal, data.conditions), turn, marker, used)[here]
    at, pose = measured[here], data.table["pose"].to_numpy()[here]
    drawn = left(sum(root @ rng.standard_normal((root.shape[1], DRAWS)) for root in (spread, alone)))
    others = (promised(other, sd, nominal + error - other, at, pose) for other in drawn.T.reshape(DRAWS, -1, 3))
    covered, worst = np.array([(other["covered"], other["worst"]) for other in others]).T
    chance = {"least": np.quantile(covered, 0.05), "chance": np.mean(worst > HARMED)}
    return promised(error, sd, nominal, at, pose) | chance


def _alone(known: cf.Calibration, data: Measurements, variance: Array) -> sparse.csc_array:
    """A root (3 · rows, n) of the covariance of what a standstill has alone, variance (rows, 3) [m²], and of the noise."""
    poses, markers = (np.unique(data.table[name], return_inverse=True)[1] for name in ("pose", "marker"))
    row, each = np.arange(variance.size), 3 * poses[:, None] + np.arange(3)
    roots = [np.sqrt(share * variance) for share in (known.intraclass, 1 - known.intraclass)]
    columns = each, each + (1 + each.max()) * markers[:, None]
    of_poses = [
        sparse.csc_array((root.ravel(), (row, column.ravel()))) for root, column in zip(roots, columns, strict=True)
    ]
    noise = known.noise(data).sigma if known.noise_known else np.zeros(len(data))
    return sparse.hstack([*of_poses, sparse.diags_array(np.repeat(noise, 3))], format="csc")


def _placing(at: Array, turn: Array, marker: Array) -> Array:
    """Derivatives (3 · rows, 6 + 3 · markers) of points by a shift and a turn of the base, and by markers' places on the flange."""
    arm = at - at.mean(axis=0)
    cross = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2)
    shift = np.broadcast_to(np.eye(3), (len(at), 3, 3))
    tools = [turn * (marker == name)[:, None, None] for name in np.unique(marker)]
    return np.concatenate([shift, cross, *tools], axis=2).reshape(3 * len(at), -1)


def _replaced(measured: Array, at: Array, turn: Array, marker: Array, used: Array) -> Array:
    """What is left of points placed by the rows used, in rounds: frames may be far apart."""
    flat, design = np.repeat(used, 3), _placing(at, turn, marker)
    for _ in range(20):
        step = np.linalg.lstsq(design[flat], (measured - at).ravel()[flat], rcond=1e-10)[0]
        rest = design[:, 6:] @ step[6:]
        middle = at.mean(axis=0)
        at = Rotation.from_rotvec(step[3:6]).apply(at - middle) + middle + step[:3] + rest.reshape(-1, 3)
        turn = Rotation.from_rotvec(step[3:6]).as_matrix() @ turn
        design = _placing(at, turn, marker)
    return measured - at


# --- Simulated arms ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Wavering:
    """Two joints that err by smooth random functions of two or three joints' angles, over rows drawn together (rows, n) [rad]."""

    error: Array

    @staticmethod
    def drawn(arm: Arm, rows: Rows, size: float, rng: np.random.Generator) -> Wavering:
        """Draw it, so that it moves the tool by size [m] rms per axis."""
        error = np.zeros((len(rows), arm.n))
        for joint in rng.choice(arm.n - 1, 2, replace=False):
            inputs = rng.choice(arm.n, int(rng.choice([2, 3])), replace=False)
            kernel = likeness(arm, rows, inputs, rng.uniform(0.7, 1.5))
            error[:, joint] = np.linalg.cholesky(kernel + 1e-8 * np.eye(len(rows))) @ rng.standard_normal(len(rows))
        error = error * np.where(arm.slide, 0.3, 1.0)
        tiny = Wavering(1e-6 * error)
        moved = tiny.points(arm, rows) - points(arm, rows)
        return Wavering(1e-6 * error * size / _rms(moved - moved.mean(axis=0)))

    def points(self, arm: Arm, rows: Rows) -> Array:
        """Where an arm is with it."""
        return points(arm, rows, [lambda arm, rows, now: replace(Yielding.none(len(rows), arm.n), joint=self.error)])

    def zero(self, arm: Arm, name: str) -> float:
        """What a parameter has of it where the mean of a joint's error is its zero's: theta of a turning joint, d of a slide."""
        part, _, field = name.partition(".")
        joint = int(part.removeprefix("joint")) - 1
        return float(self.error[:, joint].mean()) if field == ("d" if arm.slide[joint] else "theta") else 0.0


def _sigma(arm: Arm, rng: np.random.Generator) -> float:
    return float(rng.uniform(3e-5, 5e-5) if arm.name == "large-6" else rng.uniform(1.5e-5, 3e-5))


LIMITS = 5.0
UNKNOWN = {"no masses", "session"}  # forms whose data need what these studies do not have


def work_simulated(place: Place) -> list[Row]:
    """Measure in a third of the range of one of the first joints, predict in the rest."""
    rng = place.rng
    arm, size = ARMS[list(ARMS)[place.number % len(ARMS)]], float(rng.uniform(1, 5))
    sigma = _sigma(arm, rng)
    rows = measured_rows(arm, 420, rng, payloads=(2,))
    here = _third(rows, rng)
    seen = Wavering.drawn(arm, rows, size * sigma, rng).points(worn(arm, rng), rows)
    return [{"arm": arm.name, "size": size} | row for row in _in_the_rest(place, arm, rows, here, seen, sigma, rng)]


def work_forms(place: Place) -> list[Row]:
    """The same of an arm with a cause in a form of its own."""
    rng, arm = place.rng, ARMS[list(ARMS)[place.number % len(ARMS)]]
    sigma = _sigma(arm, rng)
    rows, real = measured_rows(arm, 300, rng), worn(arm, rng)
    here = _third(rows, rng)
    forms = [form for form in FORMS if arm.name in form.arms and form.kind != "device" and not UNKNOWN & {*form.needs}]
    world = other_forms.World(arm, real, rows.only(here), np.zeros(0), sigma * np.eye(here.sum()))
    form = forms[int(rng.integers(len(forms)))]
    hidden = other_forms.placed(form, world, LIMITS, True, rng).hidden
    truth: Row = {"arm": arm.name, "form": form.name, "joint": hidden.joint}
    seen = measured(real, rows, (hidden,))
    return [truth | row for row in _in_the_rest(place, arm, rows, here, seen, sigma, rng, timed=True)]


def _third(rows: Rows, rng: np.random.Generator) -> Array:
    """The mask of rows (rows,) in a third of the range of one of the first joints."""
    joint = int(rng.integers(0, 2))
    third = np.quantile(rows.q[:, joint], np.array([0, 1 / 3]) + rng.uniform(0, 2 / 3))
    return (rows.q[:, joint] >= third[0]) & (rows.q[:, joint] <= third[1])


def _in_the_rest(
    place: Place, arm: Arm, rows: Rows, here: Array, seen: Array, sigma: float, rng: np.random.Generator, *, timed: bool = False
) -> list[Row]:  # fmt: skip
    """Calibrate by some rows, and judge the others; timed: when they were measured, and how they were reached, is known."""
    columns = {"approach", "travel", "time", "temperature"} if timed else ("approach",)
    noisy = seen[here] + sigma * rng.standard_normal(seen[here].shape)
    known = _calibrated(place, arm, rows.only(here), noisy, sigma, columns=columns)
    nominal = _replaced(seen, points(arm, rows), _turns(arm, rows), rows.marker, here)[~here]
    found = []
    for stage, calibration in stages(known).items():
        at = predicted(calibration, rows.only(~here), timed=timed)
        names = names_of(calibration) if calibration.diagnosed else pd.DataFrame()
        row: Row = {
            "stage": stage,
            "names": ";".join(f"{name['cause']}:{joint_of(name)}" for _, name in names.iterrows()),
        }
        found.append(row | promised(at.position - seen[~here], at.sd, nominal, seen[~here], rows.pose[~here]))
    return found


def _turns(arm: Arm, rows: Rows) -> Array:
    return arm.base.as_matrix() @ flange(arm, rows).turn


def _calibrated(place: Place, arm: Arm, rows: Rows, seen: Array, sigma: float, **more: object) -> cf.Calibration:
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, arm, rows, seen, sigma=sigma, **more)
        return identified(folder)


# --- Parameters ----------------------------------------------------------------------------------------

FIELDS = ("alpha", "a", "d", "theta", "beta")
TOLD = 0.5  # of its prior's standard deviation: what is less sure than that is the prior's


def work_parameters(place: Place) -> list[Row]:
    """Calibrate an arm drawn from the priors, and hold each parameter's interval against the truth."""
    rng = place.rng
    arm, size = ARMS[list(ARMS)[place.number % len(ARMS)]], float(rng.uniform(1, 5))
    sigma = _sigma(arm, rng)
    rows = measured_rows(arm, 100, rng)
    with tempfile.TemporaryDirectory() as apart:
        write_study(Path(apart), arm, rows, points(arm, rows), sigma=sigma)
        study = load_study(Path(apart) / "study.toml")
        expected = cf.Parameters.of(study.robot, study.measurements(), study.file.effects)
    geometry = [name for name in expected if name.startswith("joint") and name.partition(".")[2] in FIELDS]
    priors = {name: expected[name].prior for name in geometry}
    truth = {name: rng.normal(*prior) for name, prior in priors.items()}
    real = replace(_with(arm, truth), compliance=arm.compliance * rng.normal(1, 0.1, arm.n))
    wavering = Wavering.drawn(arm, rows, size * sigma, rng)
    seen = wavering.points(real, rows)
    noisy = seen + sigma * rng.standard_normal(seen.shape)
    known = _calibrated(place, arm, rows, noisy, sigma)
    plain = _least_squares(real, rows, noisy, truth, priors)
    found = []
    for name, true in truth.items():
        mine = known.parameters[name]
        row: Row = {
            "arm": arm.name,
            "size": size,
            "parameter": name,
            "z": (mine.value - true) / mine.sd,
            "plain_z": plain[name],
            "zero_z": (mine.value - true - wavering.zero(arm, name)) / mine.sd,
        }
        found += [row] if mine.sd < TOLD * priors[name][1] else []
    return found


def _with(arm: Arm, off: dict[str, float]) -> Arm:
    changed = {field: np.array(getattr(arm, field)) for field in FIELDS}
    for name, value in off.items():
        part, _, field = name.partition(".")
        changed[field][int(part.removeprefix("joint")) - 1] += value
    return replace(arm, **changed)


def _least_squares(real: Arm, rows: Rows, seen: Array, truth: dict[str, float], priors: dict) -> dict[str, float]:
    """Errors over standard deviations of plain least squares, linear about the truth; noise by what is left, the same priors."""
    start, step, spring = points(real, rows), 1e-6, 1e-9
    columns = [(points(_with(real, {name: step}), rows) - start).ravel() / step for name in truth]
    columns += [(points(replace(real, compliance=real.compliance + spring * np.eye(real.n)[i]), rows) - start).ravel() / spring
                for i in range(real.n)]  # fmt: skip
    design = np.column_stack([*columns, _placing(start, _turns(real, rows), rows.marker)])
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    wide = np.full(design.shape[1] - len(truth), 1.0)
    error, design = (seen - start).ravel(), design / scale
    sd = np.concatenate([[priors[name][1] for name in truth], wide]) * scale
    off = np.concatenate([[priors[name][0] - truth[name] for name in truth], 0 * wide]) * scale
    left, level = error, _rms(error)
    for _ in range(5):
        inverse = np.linalg.inv(design.T @ design / level**2 + np.diag(1 / sd**2))
        at = inverse @ (design.T @ error / level**2 + off / sd**2)
        left = error - design @ at
        level = np.sqrt((left**2).sum() / max(len(left) - np.trace(inverse @ design.T @ design) / level**2, 1))
    return dict(zip(truth, at[: len(truth)] / np.sqrt(np.diag(inverse)[: len(truth)]), strict=True))


def tell_parameters(rows: pd.DataFrame) -> str:
    """The share of parameters within their 95 % intervals, beside plain least squares', by arm, size of the background and field.

    zero is the share where the mean of a joint's own error counts as its zero's.
    """
    rows = rows.assign(all="all", background=pd.cut(rows["size"], [1, 2, 3, 4, 5]),
                       field=rows["parameter"].str.partition(".")[2])  # fmt: skip
    kinds = {"covered": "z", "zero": "zero_z", "plain": "plain_z"}
    rows = rows.assign(**{name: rows[z].abs() < WITHIN for name, z in kinds.items()})
    shares = {"n": ("z", "size")} | {name: (name, "mean") for name in kinds}
    tables = (rows.groupby(key, observed=True).agg(**shares).round(3) for key in ("all", "arm", "background", "field"))
    return "\n\n".join(table.to_string() for table in tables)


# --- Later -----------------------------------------------------------------------------------------------

AHEAD = (1.0, 24.0)  # hours
WANDERS = ("device", "warm-up", "both")
OTHER_WANDERS = ("zeros", "scale")
OFF = 1.5 * HOUR
MEASURED, EACH = 120, 60  # poses to calibrate by, and to predict at each time ahead
CONTINUED = 24  # walks after the measurement: what one comes to in a day says little of its promise


def work_later(place: Place, wanders: tuple[str, ...] = WANDERS) -> list[Row]:
    """Measure through hours with a pause while device or robot wander, and predict an hour and a day on."""
    rng, (wander, name) = place.rng, list(product(wanders, ARMS))[place.number % (len(wanders) * len(ARMS))]
    arm = ARMS[name]
    sigma, size = _sigma(arm, rng), float(rng.uniform(1, 5))
    rows = measured_rows(arm, MEASURED + EACH * len(AHEAD), rng, payloads=(2,))
    pause = rng.uniform(2, 9) * HOUR * (np.arange(MEASURED) >= MEASURED // 2)
    time = np.cumsum(rng.uniform(30, 90, MEASURED)) + pause
    time = np.concatenate([time, *(time[-1] + ahead * HOUR + 10.0 * np.arange(EACH) for ahead in AHEAD)])
    rows = replace(rows, time=time, temperature=np.full(len(time), 21.0))
    block = np.repeat(np.arange(len(AHEAD) + 1), [MEASURED, *[EACH] * len(AHEAD)])
    here = block == 0
    seen = _wandering(worn(arm, rng), rows, size * sigma, wander, rng)
    noisy = seen[0] + sigma * rng.standard_normal(seen[0].shape)
    known = _calibrated(place, arm, rows.only(here), noisy[here], sigma, columns=("approach", "time"))
    nominal, found = _replaced(seen[0], points(arm, rows), _turns(arm, rows), rows.marker, here), []
    for stage, calibration in stages(known).items():
        told = _told(calibration) if calibration.diagnosed else {}
        for k, ahead in enumerate(AHEAD, start=1):
            those = block == k
            at = predicted(calibration, rows.only(those), timed=True)
            error = at.position - seen[:, those]
            row: Row = {"arm": arm.name, "wander": wander, "size": size, "stage": stage, "ahead_h": ahead}
            row |= {"converged": calibration.fit_summary.converged, "framed": _framed(error, at)}
            sd, pose = np.tile(at.sd, (CONTINUED, 1)), np.tile(rows.pose[those], CONTINUED)
            wrong = nominal[those] + seen[:, those] - seen[0, those]  # the walk goes on for either robot
            found.append(
                row | told | promised(*(each.reshape(-1, 3) for each in (error, sd, wrong, seen[:, those])), pose)
            )
    return found


def _told(calibration: cf.Calibration) -> Row:
    """Whether the wandering is named, or called unexplained."""
    names = set(names_of(calibration)["cause"])
    unexplained = bool((calibration.findings.table["status"] == "unexplained").any())
    return {
        "names": ";".join(sorted(names)),
        "told": bool(names & {*DEVICE, "thermal-growth", "housing-growth"}) or unexplained,
    }


def _framed(error: Array, at: Prediction) -> float:
    """The share of errors (CONTINUED, rows, 3) within their 95 % intervals where the device's frame is fitted anew at that hour."""
    rows, each = len(at.position), error.reshape(len(error), -1).T
    design = _placing(at.position, np.zeros((rows, 3, 3)), np.zeros(rows))[:, :6]
    left = each - design @ np.linalg.lstsq(design, each)[0]
    return float(np.mean(np.abs(left) < WITHIN * at.sd.reshape(-1, 1)))


def _wandering(real: Arm, rows: Rows, size: float, wander: str, rng: np.random.Generator) -> Array:
    """Points (CONTINUED, rows, 3) of an arm whose links or zeros go by its warmth, seen by a device whose frame or scale walks.

    size is each one's rms per axis over the measured rows [m].
    """
    there = points(real, rows)
    moves = []
    if wander in ("device", "both"):
        walk = _walks(rows, 6, rng)
        moves.append(walk[..., :3] + np.cross(walk[..., 3:] / 3.0, there))
    if wander in ("warm-up", "both"):
        warm = _warmth(rows, rng)
        grown = replace(real, a=real.a * (1 + 1e-6 * warm * rng.uniform(0.3, 1.5, real.n)),
                        d=real.d * (1 + 1e-6 * warm * rng.uniform(0.3, 1.5, real.n)))  # fmt: skip
        moves.append(points(grown, rows) - there)
    if wander == "zeros":
        turned = replace(rows, q=rows.q + 1e-6 * _warmth(rows, rng) * rng.standard_normal(real.n))
        moves.append(points(real, turned) - there)
    if wander == "scale":
        at = rng.uniform(0, 2 * np.pi)
        stand = rng.uniform(2, 4) * np.array([np.cos(at), np.sin(at), 0.3])
        moves.append((there - stand) * _walks(rows, 1, rng))
    measured = (moved.reshape(-1, *there.shape)[0, :MEASURED] for moved in moves)
    sizes = (_rms(moved - moved.mean(axis=0)) for moved in measured)
    seen = there + sum(size * moved / whole for moved, whole in zip(moves, sizes, strict=True))
    return np.broadcast_to(seen, (CONTINUED, *there.shape))


def _walks(rows: Rows, n: int, rng: np.random.Generator) -> Array:
    """Random walks (CONTINUED, rows, n) that are one while it is measured."""
    steps = np.repeat(rng.standard_normal((1, len(rows), n)), CONTINUED, axis=0)
    further = steps[1:, MEASURED:]
    further[:] = rng.spawn(1)[0].standard_normal(further.shape)
    return np.cumsum(np.sqrt(np.diff(rows.time, prepend=rows.time[0]))[:, None] * steps, axis=1)


def _warmth(rows: Rows, rng: np.random.Generator) -> Array:
    """How warm an arm is (rows, 1), over as warm as it gets: it is switched off in pauses."""
    warm, constant, at = np.empty((len(rows), 1)), rng.uniform(0.3, 1.5) * HOUR, 0.0
    for k, gone in enumerate(np.diff(rows.time, prepend=rows.time[0])):
        aim = 0.0 if gone > OFF else 1.0
        at = aim + (at - aim) * np.exp(-gone / constant)
        warm[k] = at
    return warm


KINDS = {
    "real": (work_real, tell_promises),
    "simulated": (work_simulated, tell_promises),
    "forms": (work_forms, tell_promises),
    "parameters": (work_parameters, tell_parameters),
    "later": (work_later, tell_promises),
    "later-otherwise": (partial(work_later, wanders=OTHER_WANDERS), tell_promises),
}

if __name__ == "__main__":
    kept_cases.run_cases(__doc__, KINDS)
