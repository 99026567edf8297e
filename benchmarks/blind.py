"""Blind cases: causes hidden in data of an independent simulator, and what the diagnosis says of them.

    python benchmarks/blind.py nulls 1000      false alarms, by kind of noise
    python benchmarks/blind.py effects 600     detection, names, sets, gains and intervals, by size
    python benchmarks/blind.py pairs 200       two causes at once
    python benchmarks/blind.py unknown 60      causes that are not in the catalogue
    python benchmarks/blind.py alike 60        near-alike causes, measured again at the poses proposed
    python benchmarks/blind.py springs 40      compliant joints without a mass known, against the model that knows them

Sizes are in detection limits: the amplitude found 95 times in 100 at the family-wise false-alarm rate of 1 %, computed for
the very robot, poses, noise and number of tests of each case. --out FILE.csv keeps the single cases.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import blind_cases as cases
import blind_verdicts as verdicts
import numpy as np
import pandas as pd
from blind_cases import Job
from blind_run import Kind, Row, guarded, hidden_names, run_case, run_kind
from scipy.stats import binomtest

from calflow.design.discrimination import MOST_NEXT_POSES
from calflow.effects.wording import NamedCause
from calflow.runs.run import run
from calflow.study import load_study
from hidden.case import Case, draw
from hidden.causes import PAYLOADS, measured_points

# --- One case ----------------------------------------------------------------------------------------


def diagnosed(job: Job) -> Row:
    """Say what is found in the case as it is."""
    return guarded(lambda folder: verdicts.told(run_case(folder, job.case, job.seed)[1]), job)


def one_cause(job: Job) -> Row:
    """Hide one cause, and compare the findings with it."""

    def work(folder: Path) -> Row:
        drawn = cases.sized(job, folder / "bare")
        case = drawn.case
        study, results = run_case(folder / "case", case, job.seed)
        (h,) = draw(case, np.random.default_rng(job.seed)).hidden
        compared = verdicts.one(h, results) | verdicts.gains(study, h, results)
        expected = {
            "rms_mm": verdicts.effect_rms(folder / "case"),
            "set_by_calculation": drawn.set_size,
            "first_by_calculation": drawn.first,
        }
        return hidden_names(case) | verdicts.told(results) | compared | expected

    return guarded(work, job)


def two_causes(job: Job) -> Row:
    """Hide two causes."""

    def work(folder: Path) -> Row:
        drawn = cases.sized(job, folder / "bare")
        _, results = run_case(folder / "case", drawn.case, job.seed)
        compared = verdicts.several(drawn.case.hidden, results)
        return hidden_names(drawn.case) | verdicts.told(results) | compared | {"beside": min(drawn.beside)}

    return guarded(work, job)


def measured_again(job: Job) -> Row:
    """Hide a cause that has near rivals; measure at the poses that are proposed, and diagnose again."""

    def work(folder: Path) -> Row:
        case = cases.sized(job, folder / "bare").case
        folder = folder / "case"
        _, results = run_case(folder, case, job.seed)
        (h,) = case.hidden
        asked = results.tables["diagnose/next_poses.csv"]
        before = verdicts.told(results) | verdicts.one(h, results)
        apart = results.tables["diagnose/separations.csv"]
        known = (
            hidden_names(case) | {f"{name}_before": value for name, value in before.items()} | {"asked": len(asked) > 0}
        )
        known |= {"at_most": apart["chance_after"].min(), "rivals": len(apart)}
        if not len(asked):
            return known
        first = asked.iloc[0]
        open_ = str(first["leaves_open"]).replace(" or ", "; ").split("; ")
        known |= {"promised": NamedCause(h.cause, h.joint).label not in open_, "chance": first["chance_after"]}
        _measure(folder, case, job.seed, asked)
        again = run(load_study(folder), folder / "run").results
        return known | verdicts.told(again) | verdicts.one(h, again)

    return guarded(work, job)


def without_masses(job: Job) -> Row:
    """Compare the diagnosis of compliant joints without masses with the identification that knows masses and springs."""

    def work(folder: Path) -> Row:
        study, results = run_case(folder / "case", job.case, job.seed)
        found = verdicts.told(results) | verdicts.held_out(study, results)
        known = replace(job.case, masses=True, effects=("geometry", "joint-compliance"))
        study, results = run_case(folder / "known", known, job.seed)
        return found | {"truth_mm": verdicts.held_out(study, results)["before_mm"]}

    return guarded(work, job)


def _measure(folder: Path, case: Case, seed: int, asked: pd.DataFrame) -> None:
    """Let the same robot go to the proposed poses, and add what the device sees there to the file."""
    world = draw(case, np.random.default_rng(seed))
    n, joints = len(asked), world.stated.n
    came = asked[[f"approach{i + 1}" for i in range(joints)]].to_numpy(float)
    travel = np.full((n, joints), np.deg2rad(30.0))
    rows = replace(
        world.rows, q=np.deg2rad(asked[[f"q{i + 1}_deg" for i in range(joints)]].to_numpy()), approach=came,
        payload=np.array([PAYLOADS.index(name) for name in asked["payload"]]), marker=np.zeros(n, int), travel=travel,
        wound=came, time=world.rows.time.max() + 30.0 * np.arange(1, n + 1), temperature=np.full(n, 20.0),
    )  # fmt: skip
    point = measured_points(world.real, rows, world.hidden)
    point = point + case.sigma * np.random.default_rng(seed + 1).standard_normal(point.shape)
    table = pd.read_csv(folder / "measurements.csv")
    more = asked[[name for name in asked if name in table]].copy()
    more["pose"] = table["pose"].max() + np.arange(1, n + 1)
    more[["x_mm", "y_mm", "z_mm"]] = 1e3 * point
    more["marker"] = table["marker"].iloc[0]
    given = {"time_s": rows.time, "temperature_degC": rows.temperature}
    given |= {f"travel{i + 1}_deg": np.rad2deg(travel[:, i]) for i in range(joints)}
    for name in table.columns.intersection(list(given)):
        more[name] = given[name]
    pd.concat([table, more], ignore_index=True).to_csv(folder / "measurements.csv", index=False)


# --- Tables ------------------------------------------------------------------------------------------


def null_table(rows: pd.DataFrame) -> str:
    """False alarms by kind of noise, and over all."""
    rows = rows.assign(causes=rows["found"] > 0, alarm=(rows["found"] > 0) | (rows["unexplained"] > 0),
                       fault=rows["faults"] > 0)  # fmt: skip
    both = pd.concat([rows, rows.assign(kind="all")])
    table = both.groupby("kind").agg(
        n=("alarm", "size"), alarms=("alarm", "sum"), rate=("alarm", "mean"), causes=("causes", "mean"),
        data_faults=("fault", "mean"), range_noise=("range_noise", "mean"), seconds=("seconds", "median"))  # fmt: skip
    bounds = [binomtest(int(k), int(n)).proportion_ci() for k, n in zip(table["alarms"], table["n"], strict=True)]
    return table.assign(low=[b.low for b in bounds], high=[b.high for b in bounds]).round(4).to_string()


def effect_table(rows: pd.DataFrame) -> str:
    """Detection and names by size, then by cause from twice the limit on."""
    large = rows[rows["size"] >= 2]
    cause = large["hidden"].str.split(":").str[0].rename("cause")
    ratio = (large["before_mm"] - large["after_mm"]).sum() / (large["before_mm"] - large["truth_mm"]).sum()
    excess = (large["after_mm"] / large["truth_mm"]).mean()
    alone = large[large["detected"].astype(bool) & (large["set_by_calculation"] == 1)]
    return "\n\n".join([
        _by(rows["size"], rows).to_string(),
        _by(cause, large).to_string(),
        f"from 2 limits on, where by calculation nothing else explains the data ({len(alone)} cases): first name right "
        f"{alone['right'].astype(float).mean():.3f}, set size {alone['set_size'].mean():.3f}",
        f"from 2 limits on: held-out gain over the true structure's {ratio:.4f}; held-out error over its {excess:.4f}",
    ])  # fmt: skip


def _by(key: pd.Series, rows: pd.DataFrame) -> pd.DataFrame:
    seen = rows[rows["detected"].astype(bool)]
    within = key[seen.index]
    inside = (seen["z"].abs() < 1.96).where(seen["z"].notna()).astype(float)
    names = (
        seen[
            [
                "right",
                "probability",
                "first_by_calculation",
                "up_to_class",
                "in_set",
                "set_size",
                "set_by_calculation",
                "found",
            ]
        ]
        .astype(float)
        .groupby(within)
        .mean()
    )
    detected = rows["detected"].astype(float).groupby(key).agg(["size", "mean"])
    cover = inside.groupby(within).agg(["mean", "count"]).set_axis(["covered", "intervals"], axis=1)
    return detected.set_axis(["n", "detected"], axis=1).join(names).join(cover).round(3)


def pair_table(rows: pd.DataFrame) -> str:
    """Both causes found, exactly and up to their class; by how far each stands out beside the other."""
    beside = pd.cut(rows["beside"].astype(float), [0, 1, 2, 3.01], labels=["below 1", "1 to 2", "2 to 3"])
    parts = rows.groupby(beside.rename("limits beside the other"), observed=True)[["right", "up_to_class"]]
    table = parts.agg(["size", "mean"]).round(3).to_string()
    return f"{table}\nall {len(rows)}: {rows[['right', 'up_to_class']].mean().round(3).to_dict()}"


def unknown_table(rows: pd.DataFrame) -> str:
    """What causes outside the catalogue are called."""
    rows = rows.assign(
        honest=(rows["unexplained"] > 0) | (rows["status"] == "one_of"),
        silent=(rows["found"] == 0) & (rows["unexplained"] == 0),
    )
    both = pd.concat([rows, rows.assign(kind="all")])
    return both.groupby("kind")[["honest", "silent", "unexplained", "found"]].mean().round(3).to_string()


def alike_table(rows: pd.DataFrame) -> str:
    """How the causes are named before, and after the proposed poses where there are any."""
    asked = rows[rows["asked"].astype(bool)]
    open_ = rows[rows["rivals"] > 0]
    left = f"left open with the poses there were {len(open_)} of {len(rows)}; worth measuring further poses for {len(asked)}"
    if asked.empty:
        return left
    asked = asked.assign(cause=asked["hidden"].str.split(":").str[0],
                         unique=(asked["status"] == "named") & (asked["right"] == True))  # noqa: E712 # fmt: skip
    table = asked.groupby("cause").agg(n=("unique", "size"), unique=("unique", "mean"), set_size=("set_size", "mean"))
    whole = asked[asked["promised"].astype(bool)]
    return (
        f"{table.round(3).to_string()}\n{left}; named alone and rightly with them: {asked['unique'].mean():.3f}\n"
        f"at most, by calculation (the best {MOST_NEXT_POSES} poses against the hardest rival alone): "
        f"{asked['at_most'].mean():.3f}\n"
        f"where they were said to tell the truth from all its rivals ({len(whole)}): "
        f"{whole['unique'].mean():.3f}; least chance of excluding a rival as stated, on average: {whole['chance'].mean():.3f}"
    )


def spring_table(rows: pd.DataFrame) -> str:
    """The gain without masses over that with them."""
    ratio = (rows["before_mm"] - rows["after_mm"]) / (rows["before_mm"] - rows["truth_mm"])
    named = rows["names"].str.contains("gravity-deflection")
    return (
        f"{len(rows)} cases, gravity-deflection found in {named.mean():.3f}; gain over that of the model with masses: "
        f"mean {ratio.mean():.4f}, least {ratio.min():.4f}; at least 0.95 in {(ratio >= 0.95).mean():.3f}"
    )


KINDS = {
    "nulls": Kind(cases.nulls, diagnosed, null_table),
    "effects": Kind(cases.effects, one_cause, effect_table),
    "pairs": Kind(cases.pairs, two_causes, pair_table),
    "unknown": Kind(cases.unknown, diagnosed, unknown_table),
    "alike": Kind(cases.alike, measured_again, alike_table),
    "springs": Kind(cases.springs, without_masses, spring_table),
}


if __name__ == "__main__":
    run_kind(__doc__, KINDS)
