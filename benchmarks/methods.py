"""Prior methods and calflow on the same measured robots: held-out poses, and poses outside the region that was measured.

    python benchmarks/methods.py ur5 --runs RUNS --pybotics PYTHON --figaroh PYTHON --out methods.csv
    python benchmarks/methods.py fanuc ur5 --without calflow

Needs CALFLOW_DATA, `pip install -e '.[bench]'` and, once, `python studies/ur5/convert.py`. RUNS keeps calflow's run folders, which
are used again. PYTHON is an interpreter that has pybotics, or figaroh. Every method sees the training rows only. Outside: fitted
to the 70 % of all poses in the middle of joint 2's readings, judged by those beyond. Times are the processor's, of the first fit.
A method that fails says why in its row, and the others go on.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from prior_methods.black_boxes import GaussianProcess, NeuralNetwork, RadialBasis
from prior_methods.calflow_run import Calflow, GeometryField
from prior_methods.fourier import Fourier
from prior_methods.method import Fitted, Method
from prior_methods.peers import Figaroh, Pybotics
from prior_methods.physical import Compliance, Geometry, Nominal
from prior_methods.splits import Split, held_out, outside
from real_data import DATA

from calflow.measurements.measurements import Measurements
from calflow.study import load_study

JUDGED = ("fanuc", "ur5", "ur10-c")  # the second series of the UR10 is much like the first


@dataclass(frozen=True)
class Errors:
    """Distances [mm] from predicted to measured position: mean, root mean square, largest; and the pose with the largest mean."""

    mean_mm: float
    rms_mm: float
    max_mm: float
    worst_pose: str

    @staticmethod
    def of(fitted: Fitted, judge: Measurements) -> Errors:
        """Judge a fitted method."""
        distance = pd.Series(1e3 * np.linalg.norm(fitted.positions(judge) - judge.position, axis=1))
        by_pose = distance.groupby(judge.table["pose"].to_numpy()).mean()
        rms = float((distance**2).mean() ** 0.5)
        return Errors(float(distance.mean()), rms, float(distance.max()), str(by_pose.idxmax()))


@dataclass(frozen=True)
class Row:
    """A method on a data set; figures are nan, and note says why, where it was not run or failed."""

    data: str
    method: str
    mean_mm: float = np.nan
    rms_mm: float = np.nan
    max_mm: float = np.nan
    worst_pose: str = ""
    outside_mean_mm: float = np.nan
    outside_rms_mm: float = np.nan
    outside_max_mm: float = np.nan
    outside_worst_pose: str = ""
    processor_s: float = np.nan
    note: str = ""


def main() -> None:
    """Print one table; --out keeps it as CSV."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="*", help=f"{', '.join(DATA)}; by default {', '.join(JUDGED)}")
    parser.add_argument("--runs", type=Path, help="folder of calflow's runs; a temporary one by default")
    parser.add_argument("--pybotics", type=Path, metavar="PYTHON", help="an interpreter that has pybotics")
    parser.add_argument("--figaroh", type=Path, metavar="PYTHON", help="an interpreter that has figaroh")
    parser.add_argument(
        "--without", nargs="+", default=[], metavar="WORD", help="leave out methods whose names begin so"
    )
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    if unknown := set(asked.data) - set(DATA):
        parser.error(f"unknown data: {', '.join(sorted(unknown))}; there are {', '.join(DATA)}")
    with tempfile.TemporaryDirectory() as folder:
        methods = [
            method
            for method in every(asked.runs or Path(folder), asked.pybotics, asked.figaroh)
            if not method.name.startswith(tuple(asked.without))
        ]
        rows = list[Row]()
        for row in judged(asked.data or JUDGED, methods):
            rows.append(row)
            if asked.out:  # kept as it goes on: the whole takes long
                pd.DataFrame(map(asdict, rows)).to_csv(asked.out, index=False, float_format="%.6g")
    print(told(rows))


def every(runs: Path, pybotics: Path | None, figaroh: Path | None) -> tuple[Method, ...]:
    """Return the methods, the simplest first."""
    return (
        Nominal(), Geometry(), Compliance(), Fourier(), RadialBasis(), GaussianProcess(), NeuralNetwork(), GeometryField(),
        Pybotics(pybotics), Figaroh(figaroh), Calflow(runs), Calflow(runs, residual_field=True),
    )  # fmt: skip


def judged(names: Sequence[str], methods: Sequence[Method]) -> Iterator[Row]:
    """Fit and judge every method on every data set, one at a time."""
    for name in names:
        data = load_study(DATA[name]).measurements()
        for method in methods:
            row = judged_on(name, method, held_out(data), outside(data))
            said = row.note or f"{row.mean_mm:.3f} mm, outside {row.outside_mean_mm:.3f} mm"
            print(f"{row.data}, {row.method}: {said}", file=sys.stderr, flush=True)
            yield row


def judged_on(name: str, method: Method, inside: Split, beyond: Split) -> Row:
    """Fit a method to both splits of a data set and judge it by what each holds out, each by itself."""
    if lacking := method.lacking(inside.train):
        return Row(name, method.name, note=f"not run: {lacking}")
    found, seconds, why = attempted(method, inside)
    there, _, why_there = attempted(method, beyond)
    note = "; ".join(dict.fromkeys(filter(None, (why, why_there and f"outside {why_there}"))))
    return Row(name, method.name, *vars(found).values(), *vars(there).values(), seconds, note)


def attempted(method: Method, split: Split) -> tuple[Errors, float, str]:
    """Return a method's errors, the processor's time of its fit [s], and why there are none where it fails."""
    try:  # whatever a method of others stumbles over: the rest of the table is still wanted
        fitted = method.fit(split.train)
        return Errors.of(fitted, split.judge), fitted.seconds, ""
    except Exception as error:
        said = str(error).strip().splitlines() or [""]
        return Errors(np.nan, np.nan, np.nan, ""), np.nan, f"failed: {type(error).__name__}: {said[-1]}"


def told(rows: Sequence[Row]) -> str:
    """Return the table as Markdown."""
    lines = [
        "| data | method | held out, mean, rms (max) [mm] | worst pose | outside, mean, rms (max) [mm] | processor [s] |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        held = f"{row.mean_mm:.3f}, {row.rms_mm:.3f} ({row.max_mm:.2f})"
        beyond = f"{row.outside_mean_mm:.3f}, {row.outside_rms_mm:.3f} ({row.outside_max_mm:.2f})"
        cells = [
            row.note if np.isnan(row.mean_mm) else held,
            row.worst_pose,
            "–" if np.isnan(row.outside_mean_mm) else beyond,
            "–" if np.isnan(row.processor_s) else f"{row.processor_s:.1f}",
        ]
        lines.append(f"| {' | '.join([row.data, row.method, *cells])} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
