"""The same answers: tables of the three studies and of thirty blind cases, of the code before against the code after.

    python benchmarks/same_answers.py keep FOLDER      write studies and cases (once), run them with this calflow into FOLDER/NAME
    python benchmarks/same_answers.py compare A B      compare two such results, table by table

    --name NAME     the result's name (`before` by default); --only hh800,case07 runs some; --processes 1

Run the older code with PYTHONPATH=OTHER/src. The studies on measured data need CALFLOW_DATA and are left out without it.
Estimates are compared in standard deviations, findings by cause, joint, status, rivals and detail, faults by cause and line.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # a process a core
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd

ROOT = Path(__file__).parents[1]
# a study of the folder studies/, and whether its data lie in CALFLOW_DATA
STUDIES = {"hh800": ("hh800", False), "fanuc": ("fanuc-r2000", True), "ur10": ("ur10-tmac", True)}
ALLOWED_SD = 1e-3
HIDDEN = (  # cause, joint, size, variant: of every kind, from barely visible to gross
    (), (), (), (),
    (("joint-backlash", 2, 120e-6),), (("joint-hysteresis", 1, 100e-6),), (("torque-backlash", 2, 300e-6),),
    (("joint-eccentricity", 3, 300e-6, 1),), (("joint-eccentricity", 2, 250e-6, 2),),
    (("periodic-joint-error", 1, 200e-6, 7.3),), (("gear-transmission-error", 2, 100e-6, 1),),
    (("gear-ratio-error", 3, 2e-3),), (("wrist-coupling", 6, 2e-3, "65"),),
    (("nonlinear-joint-stiffness", 2, 1e-3),), (("bearing-compliance", 2, 3e-7),), (("link-bending", 4, 3e-7),),
    (("link-torsion", 2, 3e-7),), (("base-compliance", 0, 5e-8),), (("gravity-compensator", 2, 5e3),),
    (("payload-mass", 0, 0.2),), (("tool-deflection", 0, 3e-7),), (("thermal-growth", 0, 23e-6),),
    (("frame-drift", 0, 3e-4),), (("frame-step", 0, 3e-4),),
    (("joint-backlash", 1, 150e-6), ("joint-eccentricity", 2, 250e-6, 2)),
    (("gravity-deflection", 0, 1.0),), (("cable-drag", 0, 3e-4),), (("random-field", 0, 1e-4),),
    (("joint-sign", 4, 1.0),), (("encoder-turn", 5, 1.0),),
)  # fmt: skip
NOISES = ("gauss", "gauss", "heavy", "range", "outliers")


def main() -> None:
    """Keep or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("keep", "compare"))
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--name", default="before")
    parser.add_argument("--only", default="")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    if asked.what == "compare":
        sys.exit(compare(*asked.folders))
    keep(asked.folders[0], asked.name, set(filter(None, asked.only.split(","))), asked.processes)


def keep(folder: Path, name: str, only: set[str], processes: int) -> None:
    """Run every study and case."""
    studies = {
        known: _study(folder / "studies" / name)
        for known, (name, outside) in STUDIES.items()
        if not outside or "CALFLOW_DATA" in os.environ
    }
    every = {**{f"case{k:02d}": _case(folder / "cases" / f"case{k:02d}", k) for k in range(len(HIDDEN))}, **studies}
    jobs = [(path, folder / name / known) for known, path in every.items() if not only or known in only]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for said in pool.imap_unordered(_run, jobs, chunksize=1):
            print(said, flush=True)


def _study(folder: Path) -> Path:
    """Copy a study, if it is not there yet."""
    if not folder.is_dir():
        shutil.copytree(ROOT / "studies" / folder.name, folder)
    return folder / "study.toml"


def _case(folder: Path, k: int) -> Path:
    """Write a case's files, if they are not there yet: every result is of the very same bytes."""
    if (folder / "study.toml").is_file():
        return folder / "study.toml"
    sys.path.insert(0, str(ROOT / "tests"))
    from hidden.case import Case, write_case
    from hidden.causes import Hidden

    without = any(cause in ("gravity-deflection",) for cause, *_ in HIDDEN[k])
    case = Case(
        robot=("serial", "hh800")[k % 2], poses=(80, 120)[k // 2 % 2], markers=(1, 1, 3)[k % 3],
        hidden=tuple(Hidden(*hidden) for hidden in HIDDEN[k]), noise=NOISES[k % len(NOISES)],
        payloads=("none", "half", "full"), columns=("approach", "travel", "time", "temperature"),
        repeats=2 if k % 7 == 3 else 1, seed=k,
    )  # fmt: skip
    if without:
        case = replace(case, masses=False, effects=("geometry",))
    write_case(folder, case, np.random.default_rng(1000 + k))
    return folder / "study.toml"


def _run(job: tuple[Path, Path]) -> str:
    study, out = job
    command = [sys.executable, "-m", "calflow", "run", str(study), "--out", str(out), "--stage", "diagnose", "--force"]
    done = subprocess.run(command, capture_output=True, text=True)
    return f"{out.name}: {done.returncode} {done.stderr.strip()[-300:]}"


# --- Comparison --------------------------------------------------------------------------------------


def compare(before: Path, after: Path) -> int:
    """Print a row a case; return 1 where something differs that must not."""
    rows = [_compared(run.name, run, after / run.name) for run in sorted(before.iterdir()) if run.is_dir()]
    table = pd.DataFrame(rows)
    print(table.to_string(index=False))
    both = table.dropna(subset=["time"])
    print(
        f"time after/before: all together {both['after_s'].sum() / both['before_s'].sum():.3f}, median {both['time'].median():.3f}"
    )
    wrong = table[table["differs"] != ""]
    print(f"{len(table) - len(wrong)} of {len(table)} the same")
    return int(len(wrong) > 0)


def _compared(name: str, before: Path, after: Path) -> dict[str, object]:
    row: dict[str, object] = {"case": name, "sd_identify": np.nan, "sd_diagnose": np.nan, "heldout": np.nan}
    row |= {"before_s": np.nan, "after_s": np.nan, "time": np.nan, "differs": ""}
    if not (after / "manifest.json").is_file() or not (before / "manifest.json").is_file():
        return row | {"differs": "" if not (before / "manifest.json").is_file() else "did not run"}
    differs = []
    for stage in ("identify", "diagnose"):
        old, new = (pd.read_csv(run / stage / "parameters.csv") for run in (before, after))
        if len(old) != len(new):
            differs.append(f"{stage}: {len(old)} and {len(new)} parameters")
            continue
        off = np.abs(new["estimate"] - old["estimate"]) / old["sd"].fillna(old["prior_share"].map(lambda _: np.inf))
        row[f"sd_{stage}"] = float(off.max())
        if off.max() > ALLOWED_SD:
            differs.append(f"{stage}: {old['parameter'][off.idxmax()]}")
    if _faults(before) != _faults(after):
        differs.append("faults")
    if (old_findings := _findings(before)) != (new_findings := _findings(after)):
        differs.append(f"findings: {sorted(old_findings ^ new_findings)}")
    old, new = (_held_out(run) for run in (before, after))
    seconds = [sum(json.loads((run / "manifest.json").read_text())["stages"][stage]["seconds"]
                   for stage in ("identify", "diagnose")) for run in (before, after)]  # fmt: skip
    return row | {"heldout": new / old, "before_s": seconds[0], "after_s": seconds[1], "time": seconds[1] / seconds[0],
                  "differs": "; ".join(differs)}  # fmt: skip


def _faults(run: Path) -> set[tuple[str, ...]]:
    table = pd.read_csv(run / "identify" / "faults.csv").fillna(0)
    return {tuple(map(str, row)) for row in table[["cause", "joint", "line", "action"]].itertuples(index=False)}


def _findings(run: Path) -> set[tuple[str, ...]]:
    table = pd.read_csv(run / "diagnose" / "findings.csv").fillna("")
    found = set()
    for row in table[["status", "cause", "joint", "detail", "rivals"]].itertuples(index=False):
        rivals = ",".join(sorted(filter(None, (name.strip() for name in re.split("[;,]", str(row.rivals))))))
        found.add((row.status, str(row.cause), str(row.joint).removesuffix(".0"), str(row.detail), rivals))
    return found


def _held_out(run: Path) -> float:
    table = pd.read_csv(run / "diagnose" / "accuracy.csv")
    judged = table[table["split"] == ("holdout" if (table["split"] == "holdout").any() else "train")]
    return float(judged["mean_mm"].iloc[-1])


if __name__ == "__main__":
    main()
