"""Blind cases: effects hidden in data of an independent simulator, and what the diagnosis says of them.

    python benchmarks/blind.py nulls 1000      false alarms, by kind of noise
    python benchmarks/blind.py effects 600     detection, names, sets, gains and intervals, by size
    python benchmarks/blind.py pairs 100       two causes at once
    python benchmarks/blind.py unknown 60      causes that are not in the catalogue
    python benchmarks/blind.py alike 40        near-alike causes, measured again at the poses proposed

Sizes are in detection limits: the amplitude found 95 times in 100 at the family-wise false-alarm rate of 1 %, computed for
the very robot, poses and noise of each case. A second argument adds --out FILE.csv for the single cases.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # a process a core
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from calflow.model import build
from calflow.robot.description import read_robot
from calflow.runs import run
from calflow.stages.accuracy import errors
from calflow.stages.identified import calibrated, identified
from calflow.study import load_study
from hidden.case import Case, draw, write_case
from hidden.causes import PAYLOADS, Hidden, measured_points

SIZES = (1.0, 1.5, 2.0, 3.0, 5.0)
FALSE_ALARM, POWER = 0.007, 0.95  # the causes' share of 1 %
NULLS = ("gauss", "heavy", "range", "outliers")
NEAR = {"gear-ratio-error", "joint-eccentricity", "link-torsion", "bearing-compliance", "link-bending", "link-mass",
        "payload-mass", "base-compliance"}  # fmt: skip
FAMILY = {"joint-eccentricity", "periodic-joint-error", "gear-transmission-error", "joint-error-map"}
CLASSES = (  # names that count as right up to their class
    FAMILY,
    {"base-compliance", "bearing-compliance"},
    {"joint-backlash", "joint-hysteresis"},
    {"link-torsion", "bearing-compliance"},
    {"gear-ratio-error", "joint-eccentricity"},
    {"payload-mass", "link-mass"},
    {"gravity-compensator", "joint-eccentricity"},
    {"link-bending", "joint-compliance", "nonlinear-joint-stiffness"},
)
UNITS = (  # cause, joints, typical size, variants, columns it needs, tests it pays for (degrees of freedom)
    ("joint-backlash", (1, 2, 3, 4, 5), 1e-4, ("",), ("approach",), 1),
    ("torque-backlash", (2, 3, 5), 1e-4, ("",), (), 1),
    ("joint-eccentricity", (1, 2, 3, 4, 5), 2e-4, (1, 2), (), 2),
    ("periodic-joint-error", (1, 2, 3, 4, 5), 1e-4, (5, 7.3, 12), (), 2),
    ("gear-transmission-error", (1, 2, 3, 5), 5e-5, (1, 2), (), 2),
    ("gear-ratio-error", (1, 2, 3, 4, 5), 5e-4, ("",), (), 1),
    ("wrist-coupling", (5, 6), 3e-4, ("54", "64", "65"), (), 1),
    ("nonlinear-joint-stiffness", (2, 3), 3e-4, ("", "break"), (), 1),
    ("bearing-compliance", (2, 3, 4), 1e-7, (1.0,), (), 2),
    ("link-bending", (2, 4), 1e-7, ("",), (), 1),
    ("link-torsion", (2, 4), 1e-7, ("",), (), 1),
    ("base-compliance", (0,), 2e-8, ("",), (), 1),
    ("gravity-compensator", (2,), 5e3, ("",), (), 2),
    ("payload-mass", (0,), 0.1, ("",), (), 1),
    ("payload-com", (0,), 0.03, ("",), (), 3),
    ("link-mass", (3,), 0.2, ("",), (), 1),
    ("tool-deflection", (0,), 1e-7, ("",), (), 1),
    ("thermal-growth", (0,), 1.2e-5, ("",), ("time", "temperature"), 1),
    ("frame-drift", (0,), 1e-4, ("",), ("time",), 3),
    ("frame-step", (0,), 1e-4, ("",), (), 3),
)  # fmt: skip


@dataclass(frozen=True)
class Job:
    """One case to simulate and diagnose."""

    case: Case
    seed: int
    size: float  # in detection limits; 0 for nulls
    kind: str


def main() -> None:
    """Run what was asked for and print its table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=sorted(WHAT))
    parser.add_argument("number", type=int)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    jobs, work, tell = WHAT[asked.what]
    rng = np.random.default_rng([asked.seed, *asked.what.encode()])
    started, rows = time.time(), []
    with multiprocessing.get_context("spawn").Pool(asked.processes) as pool:
        for k, row in enumerate(pool.imap_unordered(work, list(jobs(asked.number, rng)))):
            rows.append(row)
            if asked.out:
                pd.DataFrame(rows).to_csv(asked.out, index=False)
            if (k + 1) % 50 == 0:
                print(f"{k + 1} of {asked.number} cases, {time.time() - started:.0f} s", file=sys.stderr, flush=True)
    table = pd.DataFrame(rows)
    failed = table["failed"].fillna("") if "failed" in table else pd.Series("", table.index)
    for message in failed[failed != ""]:
        print("failed:", message)
    print(tell(table[failed == ""]))


# --- Cases -------------------------------------------------------------------------------------------


def null_jobs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Nothing hidden, under every kind of noise."""
    for k in range(number):
        case = replace(_design(rng), noise=NULLS[k % len(NULLS)], columns=("approach", "time", "temperature"))
        yield Job(case, int(rng.integers(2**31)), 0.0, case.noise)


def effect_jobs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """One effect, anywhere, at any size."""
    for k in range(number):
        case = _design(rng)
        h, columns = _unit(rng, case)
        case = replace(case, hidden=(h,), columns=tuple(dict.fromkeys((*case.columns, *columns))))
        yield Job(case, int(rng.integers(2**31)), SIZES[k % len(SIZES)], h.cause)


def pair_jobs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Two effects of different kinds, each three times its limit."""
    for _ in range(number):
        case = _design(rng)
        (first, a), (second, b) = _unit(rng, case), _unit(rng, case)
        while second.cause == first.cause:
            second, b = _unit(rng, case)
        columns = tuple(dict.fromkeys((*case.columns, *a, *b)))
        yield Job(replace(case, hidden=(first, second), columns=columns), int(rng.integers(2**31)), 3.0, "pair")


def unknown_jobs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Causes outside the catalogue, of 0.15 mm or so."""
    kinds = (
        (Hidden("third-order", 2, 2e-4), ("approach",), 'leave_out = ["periodic-joint-error", "joint-error-map"]'),
        (Hidden("third-order", 1, 1.5e-4), ("approach",), 'leave_out = ["periodic-joint-error", "joint-error-map"]'),
        (Hidden("cable-drag", 0, 3e-4), ("approach",), ""),
        (Hidden("random-field", 0, 1e-4), ("approach",), ""),
        (Hidden("floor-vibration", 0, 1.5e-4), ("approach", "time"), ""),
    )
    for k in range(number):
        hidden, columns, settings = kinds[k % len(kinds)]
        case = replace(_design(rng), hidden=(hidden,), columns=columns, poses=120,
                       settings=f"[stages.diagnose]\n{settings}\n" if settings else "")  # fmt: skip
        yield Job(case, int(rng.integers(2**31)), 0.0, hidden.cause)


def alike_jobs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Causes with near rivals, twice their limit."""
    kinds = [
        (h, j, s, e)
        for h, joints, s, extras, *_ in UNITS
        if h in NEAR
        for j in joints
        for e in extras
        if j in (0, 2, 3, 4)
    ]
    for _ in range(number):
        cause, joint, size, extra = kinds[int(rng.integers(len(kinds)))]
        case = replace(_design(rng), payloads=("none", "half", "full"), markers=1)
        yield Job(replace(case, hidden=(Hidden(cause, joint, size, extra),)), int(rng.integers(2**31)), 2.0, cause)


def _design(rng: np.random.Generator) -> Case:
    robot = str(rng.choice(["serial", "hh800"]))
    payloads = [("none", "half", "full"), ("full",)][int(rng.random() < 0.3)]
    return Case(
        robot=robot, poses=int(rng.choice([60, 120])) * 4 // 3, payloads=payloads, markers=int(rng.choice([1, 3]))
    )


def _unit(rng: np.random.Generator, case: Case) -> tuple[Hidden, tuple[str, ...]]:
    while True:
        cause, joints, size, extras, columns, _ = UNITS[int(rng.integers(len(UNITS)))]
        joint, extra = int(rng.choice(joints)), extras[int(rng.integers(len(extras)))]
        if cause == "wrist-coupling":
            joint = int(str(extra)[0])
        if len(case.payloads) > 1 or cause not in ("payload-mass", "tool-deflection", "link-mass"):
            return Hidden(cause, joint, size, extra), columns


# --- One case ----------------------------------------------------------------------------------------


def diagnose_null(job: Job) -> dict[str, object]:
    """Say what is found where nothing is hidden."""
    return _guarded(lambda folder: _seen(job, _run(folder, job)), job)


def diagnose_effect(job: Job) -> dict[str, object]:
    """Hide one effect at its size in detection limits, and compare the findings with it."""

    def work(folder: Path) -> dict[str, object]:
        scaled = _scaled(job)
        tables = _run(folder, scaled)
        return _seen(scaled, tables) | _gain(folder, scaled, tables)

    return _guarded(work, job)


def diagnose_pair(job: Job) -> dict[str, object]:
    """Hide two effects."""
    return _guarded(lambda folder: _seen(scaled := _scaled(job), _run(folder, scaled)), job)


def diagnose_alike(job: Job) -> dict[str, object]:
    """Hide an effect that has near rivals; measure at the poses that are proposed, and diagnose again."""

    def work(folder: Path) -> dict[str, object]:
        scaled = _scaled(job)
        tables = _run(folder, scaled)
        asked = tables["diagnose/next_poses.csv"]
        first = _seen(scaled, tables)
        if not len(asked):
            return first | {"asked": False}
        _measure_more(folder, scaled, asked)
        return _seen(scaled, run(load_study(folder), folder / "run").tables) | {
            "asked": True,
            "before": first["status"],
        }

    return _guarded(work, job)


def _measure_more(folder: Path, job: Job, asked: pd.DataFrame) -> None:
    """Let the same robot go to the proposed poses, and add what the device sees there to the file."""
    world = draw(job.case, np.random.default_rng(job.seed))
    n, robot = len(asked), world.stated.n
    came = asked[[f"approach{i + 1}" for i in range(robot)]].to_numpy(float)
    payload = np.array([PAYLOADS.index(name) for name in asked["payload"]])
    rows = replace(
        world.rows, q=np.deg2rad(asked[[f"q{i + 1}_deg" for i in range(robot)]].to_numpy()), payload=payload,
        marker=np.zeros(n, int), approach=came, travel=np.full((n, robot), 0.5), wound=came,
        time=world.rows.time.max() + 30.0 * np.arange(1, n + 1), temperature=np.full(n, 20.0),
    )  # fmt: skip
    point = measured_points(world.real, rows, world.hidden)
    point = point + job.case.sigma * np.random.default_rng(job.seed + 1).standard_normal(point.shape)
    table = pd.read_csv(folder / "measurements.csv")
    more = asked[[c for c in asked if c in table]].copy()
    more["pose"] = table["pose"].max() + np.arange(1, n + 1)
    more[["x_mm", "y_mm", "z_mm"]] = 1e3 * point
    more["marker"] = table["marker"].iloc[0]
    pd.concat([table, more], ignore_index=True).to_csv(folder / "measurements.csv", index=False)


def _guarded(work: Callable[[Path], dict[str, object]], job: Job) -> dict[str, object]:
    started = time.time()
    told = {"kind": job.kind, "size": job.size, "seed": job.seed, "robot": job.case.robot, "poses": job.case.poses,
            "payloads": len(job.case.payloads), "markers": job.case.markers}  # fmt: skip
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        try:
            told |= work(Path(folder) / "case")
        except Exception as error:  # one bad case must not end the others
            told["failed"] = f"{type(error).__name__}: {error} ({job})"
    return told | {"seconds": time.time() - started}


def _run(folder: Path, job: Job) -> dict[str, pd.DataFrame]:
    write_case(folder, job.case, np.random.default_rng(job.seed))
    return run(load_study(folder), folder / "run").tables


def _scaled(job: Job) -> Job:
    limits = [_limit(job, k) for k in range(len(job.case.hidden))]
    hidden = tuple(replace(h, size=h.size * job.size * limit) for h, limit in zip(job.case.hidden, limits, strict=True))
    return replace(job, case=replace(job.case, hidden=hidden))


def _limit(job: Job, which: int) -> float:
    """The detection limit of one hidden effect, as a factor on its size."""
    case = job.case
    world = draw(case, np.random.default_rng(job.seed))
    unit = world.hidden[which]
    small = replace(unit, size=0.1 * unit.size)
    shift = 10 * (measured_points(world.real, world.rows, (small,)) - measured_points(world.real, world.rows, ()))
    with tempfile.TemporaryDirectory() as folder:
        write_case(Path(folder), case, np.random.default_rng(job.seed))
        data = load_study(folder).measurements()
        robot = read_robot(Path(folder) / "robot.toml")
    model = build(robot, case.effects, data.given)
    start = model.nominal.copy()
    compliances = [k for k, p in enumerate(model.parameters) if p.effect == "joint-compliance"]
    start[compliances] = world.real.compliance
    train = np.flatnonzero(data.train)
    jacobian = model.position_jacobian(start, data.rows[:, train]).reshape(-1, len(start)) / case.sigma
    whole = np.vstack([jacobian, np.diag(1 / model.prior_sd)])
    effect = np.concatenate([shift[train].ravel() / case.sigma, np.zeros(len(start))])
    basis, _ = np.linalg.qr(whole)
    visible = float(((effect - basis @ (basis.T @ effect)) ** 2).sum())
    freedom = next(u[5] for u in UNITS if u[0] == unit.cause)
    return float(np.sqrt(_needed(TESTS[unit.cause], freedom) / visible))


TESTS = dict.fromkeys((u[0] for u in UNITS), 60.0) | {  # tests that a cause pays for: all places times its own scan
    "joint-eccentricity": 120.0, "periodic-joint-error": 2400.0, "gear-transmission-error": 120.0,
    "nonlinear-joint-stiffness": 180.0, "tool-deflection": 100.0, "thermal-growth": 180.0, "frame-drift": 100.0,
    "frame-step": 2000.0, "joint-hysteresis": 180.0,
}  # fmt: skip


def _needed(tests: float, freedom: int) -> float:
    """The noncentrality at which a test passes its family's gate 95 times in 100."""
    threshold = chi2.isf(FALSE_ALARM / tests, freedom)
    return float(brentq(lambda x: ncx2.sf(threshold, freedom, x) - POWER, 1e-3, 1e4))


def _seen(job: Job, tables: dict[str, pd.DataFrame]) -> dict[str, object]:
    """What the findings say of the hidden causes."""
    found = tables["diagnose/findings.csv"].fillna({"cannot_tell_from": "", "joint": 0, "cause": ""})
    causes = found[found["status"].isin(["named", "one_of"]) & (found["cause"] != "range-noise")]
    told: dict[str, object] = {
        "found": len(causes), "names": " + ".join(f"{c}:{int(j)}" for c, j in zip(causes["cause"], causes["joint"], strict=True)),
        "unexplained": int((found["status"] == "unexplained").sum()), "faults": int((found["status"] == "data_fault").sum()),
        "range_noise": int((found["cause"] == "range-noise").sum()),
    }  # fmt: skip
    rights = [_matches(h, causes) for h in job.case.hidden]
    if not rights:
        return told
    if len(rights) == 2:
        return told | {"up_to_class": all(r["up_to_class"] for r in rights), "right": all(r["right"] for r in rights)}
    return told | rights[0] | _interval(job, causes)


def _matches(h: Hidden, causes: pd.DataFrame) -> dict[str, object]:
    """Whether the first finding is right: exactly, up to its class, in its set; and whether any finding is."""
    sets = [
        {c, *filter(None, others.split(";"))}
        for c, others in zip(causes["cause"], causes["cannot_tell_from"], strict=True)
    ]
    exact = [
        c == h.cause and (j == h.joint or not h.joint) for c, j in zip(causes["cause"], causes["joint"], strict=True)
    ]
    alike = [
        e or any({c, h.cause} <= group for group in CLASSES) or h.cause in s
        for e, c, s in zip(exact, causes["cause"], sets, strict=True)
    ]
    return {
        "detected": bool(len(causes)), "right": bool(exact[:1] == [True]) if len(rights := exact) < 2 else any(rights),
        "first_right": bool(exact and exact[0]), "first_up_to_class": bool(alike and alike[0]), "up_to_class": any(alike),
        "in_set": any(h.cause in s for s in sets), "set_size": len(sets[0]) if sets else np.nan,
        "probability": float(causes["probability"].iloc[0]) if len(causes) else np.nan,
        "status": causes["status"].iloc[0] if len(causes) else "",
    }  # fmt: skip


def _interval(job: Job, causes: pd.DataFrame) -> dict[str, object]:
    """Whether the 95 % interval of an amplitude holds the true one, where both are the same figure."""
    h = job.case.hidden[0]
    same = {"joint-backlash", "torque-backlash", "joint-eccentricity", "gear-transmission-error", "gear-ratio-error",
            "wrist-coupling", "link-bending", "link-torsion", "base-compliance", "payload-mass", "link-mass",
            "payload-com", "thermal-growth", "frame-step"}  # fmt: skip
    if h.cause not in same or not len(causes) or causes["cause"].iloc[0] != h.cause:
        return {}
    if h.joint and causes["joint"].iloc[0] != h.joint:
        return {}
    error = (float(causes["estimate"].iloc[0]) - h.size) / float(causes["sd"].iloc[0])
    return {"z": error}


def _gain(folder: Path, job: Job, tables: dict[str, pd.DataFrame]) -> dict[str, object]:
    """The held-out gain against that of the true structure, fitted to the same rows and judged without noise."""
    study = load_study(folder)
    data = study.measurements()
    base = identified(study.robot, tables, data.given)
    best = calibrated(study.robot, tables, data.given)
    held = data.only(data.held_out)
    rows = json.loads((folder / "answer.json").read_text(encoding="utf-8"))["causes"][0]["rows_mm"]
    return {
        "error_before": _mean(base, held),
        "error_after": _mean(best, held),
        "effect_rms": float(np.sqrt(np.mean(np.square(rows)))),
    }


def _mean(known: object, held: object) -> float:
    return float(1e3 * np.linalg.norm(errors(known.model, known.estimate, held), axis=1).mean())


# --- Tables ------------------------------------------------------------------------------------------


def null_table(rows: pd.DataFrame) -> str:
    """False alarms by kind of noise."""
    alarm = (rows["found"] > 0) | (rows["unexplained"] > 0)
    any_fault = rows["faults"] > 0
    told = rows.assign(causes=rows["found"] > 0, alarm=alarm, fault=any_fault).groupby("kind").agg(
        n=("alarm", "size"), causes=("causes", "mean"), with_unexplained=("alarm", "mean"), data_faults=("fault", "mean"),
        range_noise=("range_noise", "mean"), seconds=("seconds", "median"))  # fmt: skip
    return told.round(4).to_string()


def effect_table(rows: pd.DataFrame) -> str:
    """Detection and names by size, then by cause."""

    def table(by: str, part: pd.DataFrame) -> pd.DataFrame:
        seen = part[part["detected"]]
        one = part.groupby(by).agg(n=("detected", "size"), detected=("detected", "mean"))
        two = seen.groupby(by).agg(
            first_right=("first_right", "mean"), up_to_class=("first_up_to_class", "mean"), in_set=("in_set", "mean"),
            set_size=("set_size", "mean"), probability=("probability", "mean"), causes=("found", "mean"),
        )  # fmt: skip
        cover = (
            seen.assign(cover=(seen["z"].abs() < 1.96).where(seen["z"].notna()))
            .groupby(by)["cover"]
            .agg(["mean", "count"])
        )
        return one.join(two).join(cover.rename(columns={"mean": "covered", "count": "n_covered"}))

    large = rows[rows["size"] >= 2]
    return f"{table('size', rows).round(3).to_string()}\n\n{table('kind', large).round(3).to_string()}"


def pair_table(rows: pd.DataFrame) -> str:
    """Both causes found, exactly and up to their class."""
    return rows[["right", "up_to_class"]].mean().round(3).to_string()


def unknown_table(rows: pd.DataFrame) -> str:
    """What causes outside the catalogue are called."""
    rows = rows.assign(
        honest=(rows["unexplained"] > 0) | (rows["status"] == "one_of"),
        silent=(rows["found"] == 0) & (rows["unexplained"] == 0),
    )
    return rows.groupby("kind")[["honest", "silent", "unexplained", "found"]].mean().round(3).to_string()


def alike_table(rows: pd.DataFrame) -> str:
    """Of the cases that asked for more poses: how many are unique and right with them."""
    asked = rows[rows["asked"].astype(bool)]
    asked = asked.assign(unique=(asked["status"] == "named") & asked["first_right"].astype(bool))
    table = asked.groupby("kind")[["unique", "first_right", "set_size"]].mean().round(3).to_string()
    return f"{table}\nasked {len(asked)} of {len(rows)}; unique and right after them {asked['unique'].mean():.3f}"


WHAT = {
    "alike": (alike_jobs, diagnose_alike, alike_table),
    "nulls": (null_jobs, diagnose_null, null_table),
    "effects": (effect_jobs, diagnose_effect, effect_table),
    "pairs": (pair_jobs, diagnose_pair, pair_table),
    "unknown": (unknown_jobs, diagnose_null, unknown_table),
}


if __name__ == "__main__":
    main()
