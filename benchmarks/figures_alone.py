"""Figures for a controller: whether they are the best that such figures can be, ever worse than the maker's, and what is promised.

    python benchmarks/figures_alone.py --cases 30

Arms of foreign_physics.py, whose joints give way, by 60 poses; of three two hide a form of foreign_forms.py besides, at 5 to 15
limits. Held against 300 new poses, measured with the same noise: the figures of `Levels` over those of a fit of geometry alone
(best), over the maker's (nominal), and what `validate` says was promised of them over what it finds (promise); the same of
corrected commands, and of all levels of effort at the poses held out.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import kept_cases
import numpy as np
import pandas as pd
from few_poses import FULL, NEW
from foreign_forms import FORMS, measured
from foreign_physics import ARMS, measured_rows, worn
from foreign_study import identified, rows_there, write_study
from kept_cases import Place, Row
from other_forms import World, placed

import calflow as cf

POSES, LIMITS, RIGHT = 60, (5.0, 15.0), (0.9, 1.15)
POSITION = ["x", "y", "z"]


def work(place: Place) -> list[Row]:
    """Calibrate a robot, and hold its figures against new poses."""
    rng, arm = place.rng, ARMS[list(ARMS)[place.number % len(ARMS)]]
    sigma = float(rng.uniform(2e-5, 5e-5))
    rows = measured_rows(arm, POSES + NEW, rng)
    here, real, hidden = rows.pose < POSES, worn(arm, rng), None
    if place.number % 3:
        forms = [form for form in FORMS if arm.name in form.arms and not FULL & set(form.needs)]
        world = World(arm, real, rows.only(here), np.zeros(0), sigma * np.eye(here.sum()))
        hidden = placed(forms[int(rng.integers(len(forms)))], world, float(rng.uniform(*LIMITS)), True, rng).hidden
    seen = measured(real, rows, (hidden,) if hidden else ()) + sigma * rng.standard_normal((len(rows), 3))
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, arm, rows.only(here), seen[here], sigma=sigma,
                    columns={"approach", "travel", "time", "temperature"}, holdout=0.3)  # fmt: skip
        known = identified(folder).diagnose()
        alone = cf.identify(known.robot, known.measured(), ["geometry"], starts=1)
        levels = known.levels
    new = rows_there(known, rows.only(~here), timed=True)
    new = replace(new, table=new.table.assign(**dict(zip(POSITION, seen[~here].T, strict=True)), sigma=sigma))
    found = known.validate(new, sent="controller figures", station="known")
    best = alone.validate(new, station="known").of("calibrated").rms_mm
    rms = {model: found.of(model).rms_mm for model in ("nominal", "figures", "calibrated")}
    commands = known.validate(new, station="known").summary.promised_mm
    return [{
        "arm": arm.name, "hidden": hidden.form.name if hidden else "", "best_mm": best, **{f"{k}_mm": v for k, v in rms.items()},
        "over_best": rms["figures"] / best, "over_nominal": rms["figures"] / rms["nominal"],
        "promise": found.summary.promised_mm / rms["figures"], "promise_commands": commands / rms["calibrated"],
        **{f"promise_level_{one.level}": one.promised / one.rms for one in levels.every},
    }]  # fmt: skip


def tell(rows: pd.DataFrame) -> str:
    """The ratios, their mean and their worst."""
    ratios = rows[[name for name in rows if name.startswith(("over_", "promise"))]].astype(float)
    told = ratios.agg(["mean", "min", "median", "max"]).T.round(3)
    within = (
        ratios[[name for name in ratios if name.startswith("promise")]].apply(lambda ratio: ratio.between(*RIGHT)).sum()
    )
    told["within"] = within.reindex(told.index)
    return f"{told.to_string()}\nworse than nominal in {(ratios['over_nominal'] > 1).sum()} of {len(rows)}"


if __name__ == "__main__":
    kept_cases.run_cases(__doc__, {"figures": (work, tell)})
