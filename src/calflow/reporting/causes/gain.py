"""What a cause, or what no cause explains, takes off the error at poses that no fit has seen."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.stats import ttest_1samp

from calflow.diagnosis.findings.finding import Finding
from calflow.files.results import Results
from calflow.files.words import mm, number
from calflow.reporting.blocks import Block, Heading, Plot
from calflow.reporting.figures.causes import gains
from calflow.reporting.material import Material, split_judged, steps
from calflow.reporting.section import Advice

WORSE = 1.02  # times the error without causes from which they do not help
HARM = 1.25  # times that error from which they do harm, however few poses say so
SURE = 0.05  # chance of so large a loss from which it is none
GAINS = (
    "What each cause takes off the mean error at held-out poses, in the order in which they were added. The order matters "
    "where causes hide each other."
)


def gain_words(one: Finding, floor: float | None) -> str:
    """Say what a cause gained on poses that no fit has seen; floor is what noise alone would leave [mm]."""
    gain, low, high = one.gain
    if math.isnan(gain):
        return "No poses were held out, so what it is worth at other poses is not known."
    interval = f"95 % interval {_signed(low)} to {_signed(high)} mm"
    noise = f"; noise alone would leave {mm(floor)} mm" if floor else ""
    if low > 0:
        return (
            f"At poses that no fit has seen it takes {mm(gain)} mm off the mean error ({interval}) and leaves "
            f"{mm(one.heldout_mean_mm)} mm{noise}."
        )
    if high < 0:
        return f"At poses that no fit has seen it makes the mean error {mm(-gain)} mm larger ({interval}): do not rely on it."
    return (
        f"At poses that no fit has seen the step that added it gained {_signed(gain)} mm, which cannot be told from nothing "
        f"({interval}); {mm(one.heldout_mean_mm)} mm are left{noise}."
    )


def gain_cells(one: Finding) -> tuple[str, str]:
    """Return a gain and its interval for a table."""
    gain, low, high = one.gain
    if math.isnan(gain):
        return "–", "–"
    return _signed(gain), f"{_signed(low)} … {_signed(high)}"


def worth(one: Finding) -> str:
    """Say what a Gaussian process would gain."""
    gain, low, high = one.gain
    if math.isnan(gain):
        return ""
    interval = f"95 % interval {_signed(low)} to {_signed(high)} mm"
    if low <= 0:
        return f" How much it matters at other poses cannot be told (a Gaussian process gains {_signed(gain)} mm, {interval})."
    return f" A Gaussian process of it, which has no physical meaning, would take {mm(gain)} mm off the mean error ({interval})."


def gained(material: Material, causes: Sequence[Finding]) -> list[Block]:
    """Draw what each cause took off, one after the other."""
    moved = [one for one in causes if math.isfinite(one.gain[0])]
    if not moved:
        return []
    before = material.tables["identify/accuracy.csv"]
    start = steps(before, split_judged(before))[-1].mean
    drawn = gains(start, labels(moved), [one.heldout_mean_mm for one in moved], np.array([one.gain[1:] for one in moved]),
                  material.noise_floor)  # fmt: skip
    data = pd.DataFrame(
        [(name, *one.gain, one.heldout_mean_mm) for name, one in zip(labels(moved), moved, strict=True)],
        columns=["cause", "gain_mean_mm", "gain_low_mm", "gain_high_mm", "heldout_mean_mm"],
    )
    unknown = (
        "" if material.noise_floor else " What noise alone would leave is not known: it was estimated from the fit."
    )
    return [Heading("What the causes gained"), Plot("gains", drawn, GAINS + unknown, data)]


def makes_it_worse(results: Results) -> list[Advice]:
    """Causes with which unseen poses fit worse were fitted to too few poses."""
    if "diagnose/accuracy.csv" not in results or split_judged(results.tables["diagnose/accuracy.csv"]) != "holdout":
        return []
    own, last = (
        steps(results.tables[f"{stage}/accuracy.csv"], "holdout")[-1].mean for stage in ("identify", "diagnose")
    )
    if last <= WORSE * own:
        return []
    said = f"{mm(last)} mm against {mm(own)} mm"
    if last > HARM * own or loss_by_chance(results) < SURE:
        sentence = (
            f"Do not use the model with the causes: at held-out poses it is worse than without them ({said}). The fitted poses "
            "are too few or too alike for so many causes; measure more."
        )
        return [Advice(1, sentence)]
    sentence = (
        f"At held-out poses the model with the causes is no better than without them ({said}), which may be chance. Measure more "
        "poses before you rely on what was found, or leave it out (stages.diagnose.leave_out)."
    )
    return [Advice(2, sentence)]


def loss_by_chance(results: Results) -> float:
    """Return the chance of so large a loss at held-out poses where the causes change nothing: Student's test of poses in pairs.

    1 where there are fewer than two poses, or all are alike.
    """
    by_pose = [
        rows[rows["split"] == "holdout"].groupby("pose")["error_mm"].mean()
        for rows in (results.tables[f"{stage}/residuals.csv"] for stage in ("diagnose", "identify"))
    ]
    lost = (by_pose[0] - by_pose[1]).dropna()
    return float(ttest_1samp(lost, 0.0, alternative="greater").pvalue) if len(lost) > 1 and lost.std() > 0 else 1.0


def labels(causes: Sequence[Finding]) -> list[str]:
    """Return the causes' names, with their details where a name comes twice."""
    names = [one.name for one in causes]
    return [f"{one.name} ({one.detail})" if names.count(one.name) > 1 and one.detail else one.name for one in causes]


def _signed(value: float) -> str:
    return number(value, ".3f")
