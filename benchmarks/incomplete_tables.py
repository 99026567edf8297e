"""How cases with a background are told: probabilities against shares right, wrong names, intervals, and what is said to be left."""

from __future__ import annotations

import pandas as pd

BINS = [0, 0.5, 0.8, 0.95, 0.99, 1]
LEFT = [0, 0.1, 0.2, 0.3, 0.5, 0.7, 10]
WITHIN = 1.96


def with_causes(rows: pd.DataFrame) -> str:
    """The hidden cause by its size and by the background's, names by their probability, and intervals."""
    rows = _judged(rows)
    found = each_finding(rows)
    z = rows["z"].dropna().astype(float)
    return "\n\n".join([
        "by size of the cause, in limits\n" + _named(rows, "size"),
        "by size of the background\n" + _named(rows, "background_size"),
        "by kind of background\n" + _named(rows, "background"),
        "findings by stated probability (right: the cause itself, or rightly a part of the background)\n"
        + calibration(found),
        f"wrong cause named as certain: {rows['certain_and_wrong'].mean():.3f} of {len(rows)} cases",
        f"95 % intervals of amplitudes cover {(z.abs() < WITHIN).mean():.3f} of {len(z)}",
        _held_out(rows),
    ])  # fmt: skip


def alone(rows: pd.DataFrame) -> str:
    """What is named where nothing is hidden but a background, and whether it is said that something is left."""
    rows = _judged(rows)
    left = rows.assign(left=pd.cut(rows["left"].astype(float), LEFT))
    return "\n\n".join([
        "by size of the background\n" + _alone(rows, "background_size"),
        "by kind of background\n" + _alone(rows, "background"),
        "by what the identified model cannot imitate of it\n" + _alone(left, "left"),
        _held_out(rows),
    ])  # fmt: skip


def each_finding(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a finding that names a cause."""
    lists = [name for name in rows if name.startswith("each_")]
    text = rows[lists].fillna("").astype(str)
    some = text["each_status"] != ""
    apart = text[some].apply(lambda column: column.str.split(";"))
    found = rows.loc[some, ["background", "background_size"]].join(apart).explode(lists)
    found = found.rename(columns=lambda name: name.removeprefix("each_"))
    found["probability"] = found["probability"].astype(float)
    for name in ("exactly", "in_set", "up_to_class", "is_background"):
        found[name] = found[name] == "True"
    return found


def calibration(found: pd.DataFrame) -> str:
    """Mean stated probability against the share that is right, by bins of probability and over all."""
    found = found.assign(
        right=found["exactly"] | found["is_background"],
        up_to_class=found["up_to_class"] | found["is_background"],
        bin=pd.cut(found["probability"], BINS).astype(str),
    )
    both = pd.concat([found, found.assign(bin="all")])
    table = both.groupby("bin").agg(
        n=("right", "size"),
        stated=("probability", "mean"),
        right=("right", "mean"),
        up_to_class=("up_to_class", "mean"),
        in_set=("in_set", "mean"),
        named=("status", lambda status: (status == "named").mean()),
    )
    return table.round(3).to_string()


def _judged(rows: pd.DataFrame) -> pd.DataFrame:
    """Add whether a case has a certain name, one that is wrong, and the truth among its findings."""
    found = each_finding(rows)
    named = found["status"] == "named"
    foreign = named & ~found["is_background"]
    certain = {
        "certain": foreign,
        "certain_strictly": named,
        "certain_and_wrong": foreign & ~found["up_to_class"],
        "truth_in_set": found["in_set"],
        "background_named": found["is_background"],
        "truth_up_to_class": found["up_to_class"],
    }
    by_case = {
        name: values.groupby(level=0).any().reindex(rows.index, fill_value=False) for name, values in certain.items()
    }
    said = rows["unexplained"] > 0
    return rows.assign(
        **by_case, said=said, said_or_named=said | by_case["background_named"], any_cause=rows["found"] > 0
    )


def _named(rows: pd.DataFrame, key: str) -> str:
    table = rows.groupby(key).agg(
        n=("found", "size"),
        in_set=("truth_in_set", "mean"),
        up_to_class=("truth_up_to_class", "mean"),
        certain_and_wrong=("certain_and_wrong", "mean"),
        found=("found", "mean"),
        unexplained=("said", "mean"),
        seconds=("seconds", "median"),
    )
    return table.round(3).to_string()


def _alone(rows: pd.DataFrame, key: str) -> str:
    table = rows.groupby(key, observed=True).agg(
        n=("found", "size"),
        left=("left", "mean") if key != "left" else ("background_size", "mean"),
        named=("certain_strictly", "mean"),
        named_but_background=("certain", "mean"),
        any_cause=("any_cause", "mean"),
        unexplained=("said", "mean"),
        unexplained_or_rightly_named=("said_or_named", "mean"),
        seconds=("seconds", "median"),
    )
    return table.round(3).to_string()


def _held_out(rows: pd.DataFrame) -> str:
    growth = rows["after_max_mm"] / rows["least_max_mm"]
    cover = (rows["covered"] * rows["coordinates"]).sum() / rows["coordinates"].sum()
    return (
        f"held-out mean after over before {(rows['after_mean_mm'] / rows['before_mean_mm']).mean():.3f}; largest error over "
        f"the least on the way: mean {growth.mean():.3f}, largest {growth.max():.3f}; 95 % intervals cover {cover:.3f} "
        f"of {int(rows['coordinates'].sum())} held-out coordinates"
    )
