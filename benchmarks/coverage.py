"""Coverage: how many held-out measurements lie in the 95 % intervals of what a run predicts, axis by axis.

python benchmarks/coverage.py STUDY RUN_FOLDER [STUDY RUN_FOLDER ...]     (CALFLOW_DATA: where studies' measurements are kept)
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calflow.estimation.accuracy import errors
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.model_tables import calibrated
from calflow.faults import corrected
from calflow.measurements.measurements import Measurements
from calflow.run_folder import read_manifest, read_results
from calflow.study import load_study

NORMAL = 1.959964  # half the width of a normal 95 % interval, in standard deviations


@dataclass(frozen=True)
class Coverage:
    """Errors of rows over their standard deviations, nan where nothing was measured: (n_rows, 3)."""

    z: np.ndarray

    @property
    def share(self) -> float:
        """Share of rows and axes within the normal 95 % interval."""
        return float(np.mean(np.abs(self.z[np.isfinite(self.z)]) < NORMAL))

    @property
    def by_axis(self) -> np.ndarray:
        """The same of each axis, shape (3,)."""
        return np.array([np.mean(np.abs(axis[np.isfinite(axis)]) < NORMAL) for axis in self.z.T])

    @property
    def rms(self) -> float:
        """Root mean square, 1 where the standard deviations are right."""
        return float(np.sqrt(np.nanmean(self.z**2)))

    @property
    def kurtosis(self) -> float:
        """How much heavier the tails are than a normal distribution's, 0."""
        return float(np.nanmean(self.z**4) / np.nanmean(self.z**2) ** 2 - 3)

    @property
    def quantile(self) -> float:
        """Half the width that would cover 95 %, in standard deviations."""
        return float(np.nanquantile(np.abs(self.z), 0.95))


def coverage(known: CalibratedModel, data: Measurements) -> Coverage:
    """Return that of the held-out rows, by their parameters', discrepancy's and device's variance."""
    own = data.only(data.held_out)
    variance = known.position_variance(own.conditions)
    if known.noise_known:  # else the noise is in already
        variance = variance + known.noise(own).sigma[:, None] ** 2
    return Coverage(errors(known.model, known.estimate, own) / np.sqrt(variance))


def of_run(path: Path, folder: Path) -> dict[str, tuple[Coverage, CalibratedModel]]:
    """Return that of each model that a run holds: identify's, and diagnose's where it went on."""
    manifest = read_manifest(folder)
    assert manifest is not None, f"{folder} holds no run"
    study = load_study(path)
    data, found = study.measurements(), {}
    results = read_results(manifest, folder, "identify")
    data = corrected(data, results.tables["identify/faults.csv"])
    known = calibrated(study.robot, results.of({"identify"}), data.given)
    found["identify"] = coverage(known, data.on(known.model.robot)), known
    if (folder / "diagnose").exists():
        results |= read_results(manifest, folder, "diagnose")
        known = calibrated(study.robot, results, data.given)
        found["diagnose"] = coverage(known, data.on(known.model.robot)), known
    return found


if __name__ == "__main__":
    print(f"{'model':32s}  rows   95 %      x     y     z   rms  kurtosis  95 % at  beyond its parameters, mm")
    for path, folder in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        for stage, (told, known) in of_run(Path(path), Path(folder)).items():
            axes = " ".join(f"{100 * share:5.1f}" for share in told.by_axis)
            label = f"{Path(folder).name} {stage}"
            print(f"{label:32s} {len(told.z):5d}  {100 * told.share:5.1f}  {axes}  {told.rms:4.2f}  {told.kurtosis:8.2f}  "
                  f"{told.quantile:7.2f}  {1e3 * known.errors.rest:.4f}", flush=True)  # fmt: skip
