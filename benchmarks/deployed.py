"""Whether a model with the causes that were found is ever worse than the one without, where they are weak or alike.

    python benchmarks/deployed.py --cases 200

Robots of few_poses.py, by 12 to 60 poses; of four three hide something of one to three detection limits, of these one beside one
of the causes that it may be called, as large, and one beside a smooth background of 0.3 to 1 noise. Both models' true root mean
square errors at 300 new poses: worse is the share of robots of which that with the causes is worse by over 2 %, suspected that of
those with a cause that was found and stayed out of the model.
"""

from __future__ import annotations

import few_poses
import kept_cases
import numpy as np
import pandas as pd
from kept_cases import Place, Row

NUMBERS, WEAK, SMOOTH = (12, 20, 36, 60), (1.0, 3.0), (0.3, 1.0)
WORSE = 1.02


def work(place: Place) -> list[Row]:
    """Draw a robot whose cause is weak, alone or not, or that has none."""
    limits, smooth = (float(place.rng.uniform(*bounds)) for bounds in (WEAK, SMOOTH))
    kind = place.number % 4
    return few_poses.case(
        place,
        NUMBERS[place.number // 3 % len(NUMBERS)],
        limits if kind else 0.0,
        alike=kind == 2,
        smooth=smooth * (kind == 3),
    )


def tell(rows: pd.DataFrame) -> str:
    """The share of robots that causes make worse, and what they gain in all."""
    done = rows[rows["refused"].isna()].pivot(index=["seed", "case"], columns="stage", values="found_mm")
    told = rows[rows["stage"] == "diagnose"].set_index(["seed", "case"]).loc[done.index]
    ratio = done["diagnose"] / done["identify"]
    table = pd.DataFrame({
        "ratio": ratio, "worse": ratio > WORSE, "better": ratio < 1 / WORSE, "poses": told["poses"],
        "hidden": np.select([told["limits"] == 0, told["smooth"] > 0, told["hidden"].str.contains(";")],
                            ["nothing", "a form beside a background", "two alike"], "a form"),
        "named": told["names"].fillna("") != "",
        "suspected": told["suspected"].astype(float) > 0,
    })  # fmt: skip
    parts = [
        table.groupby(key)[["ratio", "worse", "better", "named", "suspected"]]
        .mean()
        .round(3)
        .assign(n=table.groupby(key).size())
        for key in ("hidden", "poses")
    ]
    worst = ratio.sort_values(ascending=False).head(5).round(3).to_string()
    return "\n\n".join([
        *(part.to_string() for part in parts), f"the worst\n{worst}",
        f"worse by over 2 % in {100 * table['worse'].mean():.1f} % of {len(table)}, better in {100 * table['better'].mean():.1f} %",
    ])  # fmt: skip


if __name__ == "__main__":
    kept_cases.run_cases(__doc__, {"deployed": (work, tell)})
