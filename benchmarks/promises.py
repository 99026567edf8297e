"""Promises of the posterior: whether drawn robots' true parameters lie in what calibrations say of them.

    python benchmarks/promises.py calibrations --cases 300      simulation-based calibration, an arm of three joints
    python benchmarks/promises.py arm --cases 300               the same of all six
    python benchmarks/promises.py markers --cases 100           three markers a pose, which a pose shifts alike by twice the noise
    python benchmarks/promises.py joints --cases 100            the same by joints that stand beside their readings
    python benchmarks/promises.py alike --cases 100             the same, nothing shared

Every case draws a robot from the model's priors, measures it, identifies and samples it, and ranks the truth among thinned
draws (Talts et al. 2018). Ranks of a right posterior are uniform: a chi² p a quantity, to be above 1 % over their number, and
a band that the
empirical distribution stays in 95 times in 100 (Säilynoja et al. 2022). The prior and the graph that make the data are the
model's own: what is tested is how they are inferred, not whether they are a real robot's.

    --seed 1   --processes 1   --out FOLDER   ranks.csv, errors.csv, summary.csv, ranks.svg
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # a process a core

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from sampling.calibrations import DRAWS, Case, Design, told
from sampling.ranks import Band, table_of

KINDS = {
    # half of the noises stated, of whatever size they really are, half left to the fit
    "calibrations": (Design(joints=3, poses=30), Design(joints=3, poses=30, stated=False)),
    "arm": (Design(), Design(stated=False)),
    "markers": (Design(poses=30, markers=3, shared=1e-4, level=0.0),),
    "joints": (Design(poses=30, markers=3, repeating=5e-5, level=0.0),),
    "alike": (Design(poses=30, markers=3, level=0.0),),
}
NORMAL = {0.5: 0.67449, 0.9: 1.644854, 0.95: 1.959964}  # half the width of a normal interval


@dataclass(frozen=True)
class Job:
    """One case of a kind."""

    kind: str
    seed: int
    case: int

    @property
    def design(self) -> Design:
        """How its robot is measured."""
        designs = KINDS[self.kind]
        return designs[self.case % len(designs)]


def work(job: Job) -> dict[str, object]:
    """Do a case; where it fails its row says how."""
    rng = np.random.default_rng([job.seed, job.case, *job.kind.encode()])
    started = time.process_time()
    try:
        found = told(Case.drawn(job.design, rng), job.design, rng)
    except Exception:  # one bad case must not end the others
        return {"case": job.case, "failed": traceback.format_exc()}
    return {"case": job.case, "found": found, "seconds": time.process_time() - started}


def main() -> None:
    """Run the cases, and print what they say."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=sorted(KINDS))
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("promises"))
    asked = parser.parse_args()
    jobs = [Job(asked.what, asked.seed, case) for case in range(asked.cases)]
    rows = []
    with multiprocessing.get_context("spawn").Pool(asked.processes) as pool:
        for row in pool.imap(work, jobs):
            if "failed" in row:
                print(f"case {row['case']} failed: {row['failed']}", flush=True)
            else:
                rows.append(row)
            if len(rows) % 20 == 0:
                print(f"{len(rows)} of {asked.cases}", file=sys.stderr, flush=True)
                tell(rows, asked.out)
    print(tell(rows, asked.out))


def tell(rows: list[dict], folder: Path) -> str:
    """Write the tables and the figure, and return what they say."""
    folder.mkdir(parents=True, exist_ok=True)
    found = [row["found"] for row in rows]
    ranks = pd.DataFrame([one.ranks for one in found], index=[row["case"] for row in rows])
    ranks.to_csv(folder / "ranks.csv", index_label="case")
    errors = pd.DataFrame(
        {"what": what, "case": row["case"], "z": z}
        for row in rows
        for what, values in (("fit", row["found"].fitted), ("predicted", row["found"].predicted.ravel()))
        for z in values
    )
    errors.to_csv(folder / "errors.csv", index=False)
    summary = table_of(ranks, DRAWS, np.random.default_rng(1))
    summary.to_csv(folder / "summary.csv", index=False)
    draw(ranks, folder / "ranks.svg")
    return words(summary, errors, rows)


def words(summary: pd.DataFrame, errors: pd.DataFrame, rows: list[dict]) -> str:
    """What the tables say."""
    n = len(summary)
    least = summary.loc[summary["p"].idxmin()]
    left = list(summary.loc[summary["leaves_band"], "quantity"])
    lines = [
        f"{len(rows)} calibrations, {np.mean([row['seconds'] for row in rows]):.1f} s of the processor each",
        f"{n} quantities, least p {least['p']:.2g} ({least['quantity']}), times {n}: {min(1.0, n * least['p']):.3f}",
        f"outside their 95 % band: {len(left)} of {n} {left}",
        "sampled intervals cover, mean over quantities (least, most):",
    ]
    pointed = summary["quantity"].str.startswith("further")
    for label, own in (("parameters and noise", ~pointed), ("points of further poses", pointed)):
        part = summary[own]
        shares = ", ".join(spread(level, 100 * part[f"in_{level}"]) for level in (50, 90, 95))
        lines.append(f"  {label}: {shares}")
    lines.append("intervals of the fit's covariance cover:")
    for what, part in errors.groupby("what"):
        z = part["z"].abs()
        shares = ", ".join(f"{100 * level:.0f} %: {100 * (z < half).mean():.1f}" for level, half in NORMAL.items())
        lines.append(f"  {what}: {shares}; rms {np.sqrt((z**2).mean()):.3f}")
    lines.append(f"parameters at a bound: {np.mean([row['found'].at_bound for row in rows]):.1f} a calibration")
    return "\n".join(lines)


def spread(level: int, shares: pd.Series) -> str:
    """Mean, least and most of what intervals cover."""
    return f"{level} %: {shares.mean():.1f} ({shares.min():.1f}, {shares.max():.1f})"


def draw(ranks: pd.DataFrame, path: Path) -> None:
    """Draw of each quantity the empirical distribution of ranks less the uniform one, and the band that it should stay in."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = 6
    band = Band.of(len(ranks), DRAWS, np.random.default_rng(1))
    n_lines = -(-ranks.shape[1] // columns)
    figure, axes = plt.subplots(n_lines, columns, figsize=(11, 1.3 * n_lines), sharex=True, sharey=True)
    at = (np.arange(DRAWS + 1) + 1) / (DRAWS + 1)
    for k, axis in enumerate(axes.flat):
        if k >= ranks.shape[1]:
            axis.axis("off")
            continue
        own = ranks.iloc[:, k].to_numpy()
        share = np.searchsorted(np.sort(own), np.arange(DRAWS + 1), side="right") / len(own)
        axis.fill_between(band.points, band.low - band.points, band.high - band.points, color="0.85", lw=0)
        axis.plot(at, share - at, color="0.1", lw=1)
        axis.set_title(ranks.columns[k], fontsize=7, pad=2)
        axis.tick_params(labelsize=6)
    figure.supxlabel("rank of the truth among the draws, as a share", fontsize=8)
    figure.supylabel("share of cases up to there, less the uniform one", fontsize=8)
    figure.tight_layout(pad=0.4)
    figure.savefig(path)
    plt.close(figure)


if __name__ == "__main__":
    main()
