"""Real data diagnosed on two disjoint halves: is what one half names found again in the other?

    python benchmarks/replication.py halves               random halves, and early against late, of every data set
    python benchmarks/replication.py halves --data ur5    of one
    python benchmarks/replication.py whole                every study as it is: errors on the way, and intervals

Needs CALFLOW_DATA. A half is whole poses, and holds out the study's own share of them. A cause is found again where the other
half names it, or its family, at the same joint, or leaves it open. --out FILE.csv keeps the single runs, FILE.pairs.csv what
was compared.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import blind_verdicts as verdicts
import held_out
import numpy as np
import pandas as pd
from real_data import DATA, columns

from calflow.files.tables import Results
from calflow.measurements.measurements import Measurements
from calflow.runs.run import run
from calflow.study import Study, load_study

WAYS = ("random", "in order")
FAMILIES = (
    verdicts.FAMILY,
    {"frame-drift", "frame-step", "session-frame"},
)  # of one angle's errors, of the device's wandering
MAPS = "joint-error-map"  # one size whatever its resolution: other causes are compared in the same form only
AGREE = 2.0  # standard deviations of the difference of two amplitudes

Row = dict[str, object]


@dataclass(frozen=True)
class Part:
    """A part of a data set to diagnose: which way it was split (empty: all poses), which half (0, 1), and the draw's seed."""

    data: str
    way: str = ""
    half: int = 0
    seed: int = 1


def main() -> None:
    """Run what was asked for and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["halves", "whole"])
    parser.add_argument("--data", nargs="+", choices=sorted(DATA), default=list(DATA))
    parser.add_argument("--way", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    parts = [Part(data) for data in asked.data]
    if asked.what == "halves":
        parts = [Part(data, way, half, asked.seed) for data in asked.data for way in asked.way for half in (0, 1)]
    rows, findings = list[Row](), dict[Part, pd.DataFrame]()
    with multiprocessing.get_context("spawn").Pool(asked.processes) as pool:
        for part, row, found in pool.imap_unordered(diagnosed, parts):
            rows.append(row)
            findings[part] = found
            print(f"{part.data} {part.way} {part.half}: {row['seconds']:.0f} s", file=sys.stderr, flush=True)
    table = pd.DataFrame(rows).sort_values(["data", "way", "half"]).set_index(["data", "way", "half"])
    compared = pd.DataFrame([row for pair in pairs(findings) for row in pair])
    if asked.out:
        table.to_csv(asked.out)
        compared.to_csv(asked.out.with_suffix(".pairs.csv"), index=False)
    print(told(table))
    if len(compared):
        print("\n" + replicated(compared))


# --- One part ----------------------------------------------------------------------------------------


def diagnosed(part: Part) -> tuple[Part, Row, pd.DataFrame]:
    """Diagnose a part; return what it says of its held-out poses, and its findings."""
    started = time.process_time()
    row: Row = {"data": part.data, "way": part.way, "half": part.half, "failed": None}
    found = pd.DataFrame()
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stdout(io.StringIO()):
        folder = Path(name)
        try:
            study = load_study(_written(part, folder))
            results = run(study, folder / "run").results
            found = verdicts.named_causes(results)
            row |= {"poses": study.measurements().table["pose"].nunique(), **verdicts.told(results), **_noise(results)}
            row |= held_out.errors(results)
            row |= held_out.covered(folder / "run", folder / "measurements.csv", results)
        except Exception as error:  # one bad part must not end the others
            row["failed"] = f"{type(error).__name__}: {error}"
    return part, row | {"seconds": time.process_time() - started}, found


def _noise(results: Results) -> Row:
    noise = results.documents["diagnose/summary.json"]["noise"][0]
    return {"sigma_mm": 1e3 * noise["sigma"], "noise": noise["source"]}


def _written(part: Part, folder: Path) -> Path:
    """Write the part as a study of its own."""
    study = load_study(DATA[part.data])
    data = study.measurements()
    table = columns(data)
    if part.way:
        if set(data.table["split"]) == {"train", "holdout"} and not _drawn(study):
            data = data.only(data.train)  # a published test is not halved
            table = columns(data)
        table = table.loc[_half(part, data)].drop(columns="split")
    folder.joinpath("measurements.csv").write_text(table.to_csv(index=False), encoding="utf-8")
    shutil.copy(study.robot_path, folder / "robot.toml")
    effects = ", ".join(f'"{effect}"' for effect in study.file.effects)
    folder.joinpath("study.toml").write_text(
        f"""\
name = "{part.data}"
robot = "robot.toml"
workflow = "diagnose"
seed = {study.file.seed}
effects = [{effects}]

[measurements]
file = "measurements.csv"

[split]
holdout = {study.file.split.holdout}
""",
        encoding="utf-8",
    )
    return folder


def _drawn(study: Study) -> bool:
    """Whether the study draws its held-out poses, rather than its file naming them."""
    source = study.measurement_path
    return source.suffix != ".csv" or "split" not in pd.read_csv(source, nrows=1)


def _half(part: Part, data: Measurements) -> np.ndarray:
    """Which rows are of the half: whole poses, drawn, or those that were measured first or last."""
    poses = data.table["pose"].unique()
    if part.way == "random":
        poses = np.random.default_rng(part.seed).permutation(poses)
    first = poses[: len(poses) // 2]
    return (data.table["pose"].isin(first) == (part.half == 0)).to_numpy()


# --- Two halves --------------------------------------------------------------------------------------


def pairs(findings: dict[Part, pd.DataFrame]) -> Iterator[list[Row]]:
    """Compare the findings of each half with those of the other, in both directions."""
    for part, found in findings.items():
        others = [
            other for other in findings if (other.data, other.way, other.half) == (part.data, part.way, 1 - part.half)
        ]
        if part.way and others:
            yield [
                {"data": part.data, "way": part.way, "half": part.half, **_again(row, findings[others[0]])}
                for _, row in found.iterrows()
            ]


def _again(row: pd.Series, others: pd.DataFrame) -> Row:
    """Whether a finding is found again, and whether both have the same size."""
    there = [other for _, other in others.iterrows()]
    same = [other for other in there if _same_figure(row, other)]
    known: Row = {"cause": row["cause"], "joint": int(row["joint"]), "detail": row["detail"], "status": row["status"]}
    known |= {"probability": row["probability"], "estimate": row["estimate"], "sd": row["sd"], "unit": row["unit"]}
    known["again"] = any(_alike(row, other) for other in there)
    if same:
        apart = abs(row["estimate"] - same[0]["estimate"]) / np.hypot(row["sd"], same[0]["sd"])
        known |= {"there": same[0]["estimate"], "apart_sd": apart, "agrees": bool(apart < AGREE)}
    return known


def _alike(row: pd.Series, other: pd.Series) -> bool:
    """Whether two findings are the same cause up to its family, or the other one leaves the first open."""
    causes = {row["cause"], other["cause"]}
    family = len(causes) == 1 or any(causes <= family for family in FAMILIES)
    return bool(
        (family and row["joint"] == other["joint"]) or (row["cause"], int(row["joint"])) in verdicts.rivals(other)
    )


def _same_figure(row: pd.Series, other: pd.Series) -> bool:
    names = ["cause", "joint", "unit"] if row["cause"] == MAPS else ["cause", "joint", "unit", "detail"]
    return all(row[name] == other[name] for name in names)


# --- Tables ------------------------------------------------------------------------------------------


def told(table: pd.DataFrame) -> str:
    """Held-out errors, the largest one against the least on the way, intervals, and what was found."""
    lines = [f"failed: {at}: {message}" for at, message in table["failed"].dropna().items()]
    whole = table[table["failed"].isna()]
    if whole.empty:
        return "\n".join(lines)
    whole = whole.assign(growth=whole["after_max_mm"] / whole["least_max_mm"])
    figures = ["poses", "before_mean_mm", "before_max_mm", "after_mean_mm", "after_max_mm", "growth", "covered", "found",
               "unexplained", "seconds"]  # fmt: skip
    lines.append(whole[figures].round(4).to_string())
    lines += [f"{' '.join(map(str, at))}: {names}" for at, names in whole["names"].items()]
    return "\n".join(lines)


def replicated(compared: pd.DataFrame) -> str:
    """The share of named causes found again in the other half, and of amplitudes that agree."""
    compared = compared.assign(agrees=compared.get("agrees"), certain=compared["status"] == "named")
    every = pd.concat([compared, compared.assign(data="all", way="both")])
    groups = every.groupby(["data", "way"], sort=False)
    table = groups.apply(
        lambda rows: pd.Series({
            "named": rows["certain"].sum(),
            "found_again": rows.loc[rows["certain"], "again"].mean(),
            "left_open": (~rows["certain"]).sum(),
            "open_found_again": rows.loc[~rows["certain"], "again"].mean(),
            "amplitudes": rows["agrees"].notna().sum(),
            "agree": rows["agrees"].dropna().astype(float).mean(),
        }),
        include_groups=False,
    )  # fmt: skip
    return table.round(3).to_string()


if __name__ == "__main__":
    main()
