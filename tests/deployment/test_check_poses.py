"""Check poses: eight of those that were measured, that show what has moved, and tell it from what else may have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.deployment.check_poses import check_poses, choose_check_poses, unmoved
from calflow.deployment.drift import drift
from calflow.deployment.movements import movements
from calflow.design.candidates import candidates
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.model import build
from estimation.data import calibration
from robots import industrial

NOISE = 5e-5


def test_eight_chosen_poses_tell_more_than_any_others_drawn():
    """Fails if poses are taken that tell less than chance does, one of them twice, or with a load that few carried, if fewer are
    chosen than asked for, or the check that is foreseen is not one of all of them on one day where nothing moved."""
    model = build(industrial(), ("geometry",))
    n = len(model.parameters)
    known = calibration(model, model.nominal, 0 * np.eye(n), NOISE)
    rng = np.random.default_rng(2)
    q = candidates(model, 60, "load", "E", None, rng)[0]
    payload = np.where(np.arange(60) < 50, "load", "")
    every = Measurements.from_arrays(
        model.robot, np.repeat(q, 2, axis=0), np.zeros((120, 3)), payload=np.repeat(payload, 2), pose=np.repeat(np.arange(60), 2),
        repeat=np.tile([1, 2], 60), sigma=np.full(120, NOISE), session=np.repeat(np.where(np.arange(60) < 30, "May", "June"), 2),
    )  # fmt: skip
    chosen = check_poses(known, every, 8)
    assert len(chosen) == chosen.table["pose"].nunique() == 8
    assert set(chosen.table["payload"]) == {"load"}

    def told(rows: Measurements) -> float:
        slope = np.concatenate([one.slope * one.sd / NOISE for one in movements(known, rows, False)], axis=2)
        flat = slope.reshape(-1, slope.shape[2])
        return float(np.linalg.slogdet(np.eye(flat.shape[1]) + flat.T @ flat)[1])

    loaded = every.only(((every.table["payload"] == "load") & (every.table["repeat"].astype(str) == "1")).to_numpy())
    drawn = [rng.choice(50, 8, replace=False) for _ in range(100)]
    others = [told(replace(loaded, table=loaded.table.iloc[own].reset_index(drop=True))) for own in drawn]
    assert told(chosen) > max(others)

    with pytest.raises(InputError, match="expected 3 to 50, the number of poses measured with payload 'load'"):
        choose_check_poses(known, every, 51)
    with pytest.raises(InputError, match="expected rows, found none"):
        drift(known, every.only(np.zeros(120, dtype=bool)))

    foreseen = drift(known, unmoved(known, chosen), station="known")
    assert (foreseen.summary.status, foreseen.summary.sessions) == ("in place", 1)
    assert foreseen.summary.error_mm < 1e-9
