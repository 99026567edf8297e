"""The section on causes: what the study's model lacked, how sure that is, and what stays unexplained or untested."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from calflow.design.discrimination import ENOUGH
from calflow.diagnosis.findings.tables import UNEXPLAINED
from calflow.diagnosis.findings.verdict import WITHIN
from calflow.files.tables import Tables
from calflow.report.document import Block, bullets, heading, paragraph, plot, table
from calflow.report.figures.diagnosis import evidence, explained, gains, in_space
from calflow.report.figures.residuals import magnification
from calflow.report.findings import (
    Alternative,
    Found,
    cause_name,
    cause_words,
    chance,
    chance_figure,
    findings,
    named,
    named_ids,
    place_name,
    place_names,
    readable_size,
    sureness,
)
from calflow.report.material import Material, item, split_judged, steps
from calflow.report.section import Advice, Section
from calflow.report.words import effect_words, listed, mm, number, plural, two_digits
from calflow.stages.diagnose import SHARES, DiagnoseSettings

SHOWN = 10  # candidates in the figure
LONGEST = 46  # letters of a name with its detail, beyond which the detail is left out
WORSE = 1.02  # times the error without causes from which they do harm
DRAWN = 700  # arrows in the workspace
STATUS = {"named": "named", "one_of": "one of several", "unexplained": "not explained"}
FAULT = "data_fault"  # told in a section of its own
NO_PROOF = (
    "A smaller error does not prove a name: whatever bends with the data takes something off. That something is there "
    "rests on the test; its name rests on what else could explain the same data, which is said with each cause."
)
NOTHING = "Nothing was found that the model lacks."
CURVES = (
    "The figures show errors along the direction in which a cause moves the tool. Left: the final model without this "
    "cause, its other parameters kept; middle: with it; right: what was measured against what the cause explains."
)
GAINS = (
    "What each cause takes off the mean error at held-out poses, in the order in which they were added. The order matters "
    "where causes hide each other."
)
EVIDENCE = (
    "The places that spoke most strongly against the study's model, each tested alone; what one cause explains, others "
    "imitate in part. Below zero a place explains less than its parameters cost; left of the gate it may be chance."
)

LIMITS = (
    "The size at which a cause would be found 95 times in 100, at each joint or link, against the scatter that the study's "
    "model leaves. What is smaller can be there unseen."
)


def write(material: Material) -> list[Block]:
    """Tell each finding in words and figures, then what is left and what could not be tested."""
    found = findings(material.tables)
    causes = [one for one in found if one.told]
    left = [one for one in found if one.status == "unexplained"]
    return [
        *_opening(material, found),
        *[block for one in causes for block in _finding(material, one)],
        *_gained(material, causes),
        *_unexplained(left),
        *_space(material, causes),
        *_evidence(material, causes),
        *_limits(material.tables["diagnose/candidates.csv"]),
        *_untested(material.tables["diagnose/candidates.csv"]),
    ]


def _opening(material: Material, every: Sequence[Found]) -> list[Block]:
    tested = item(material.tables["diagnose/summary.csv"], "causes_tested")
    searched = (
        f"What the study's model leaves was searched for {tested} causes, each at its place in the robot or its "
        f"surroundings. A cause counts as found where, with nothing hidden, fewer than {100 * _gate(material):.2g} % of such "
        f"searches would find anything.{_mended(every)}"
    )
    found = [one for one in every if one.status != FAULT]
    if not found:
        best = _strongest(material.tables["diagnose/candidates.csv"])
        return [paragraph(NOTHING, bold=True), paragraph(f"{searched}{best}")]
    rows = [
        (str(one.order or "–"), _title(one), one.amount if one.told and one.unit else "–", STATUS.get(one.status, one.status),
         chance_figure(one.p), sureness(one.probability), *_gain_cells(one))
        for one in found
    ]  # fmt: skip
    header = ("", "finding", "size (± 1 sd)", "name", "false alarm", "probability", "gain [mm]", "95 % interval")
    told = any(one.told for one in found)
    first = [] if told else [paragraph("No cause of the catalogue was found.", bold=True)]
    listing = [paragraph(NO_PROOF), table(header, rows, "rlrlrrrr", size=8, wide=1)]
    return [
        *first,
        paragraph(searched),
        *listing,
        *([paragraph(CURVES)] if any(_moves(material, one) for one in found) else []),
    ]


def _mended(every: Sequence[Found]) -> str:
    """Say that the search was made on data whose faults were seen to."""
    faults = dict.fromkeys(effect_words(one.cause) for one in every if one.status == FAULT)
    return (
        f" Faults of the data ({listed(list(faults))}) were seen to before: see the section on them." if faults else ""
    )


def _finding(material: Material, one: Found) -> list[Block]:
    head = f"{one.order}. {_first_up(one.names)}"
    text = " ".join(
        part for part in (_what(one), how_sure(one), *_apart(one, material.tables), _gain(material, one)) if part
    )
    return [heading(head), paragraph(text), *_curve(material, one)]


def _what(one: Found) -> str:
    words = cause_words(one.cause)
    size = f"{words.size} {one.amount}" if one.unit else ""
    if one.of_family:
        best = f"{words.name} ({one.detail})" if one.detail else words.name
        return f"The angle of joint {one.joint} is off by an amount that goes with the angle; best described as {best}: {size}."
    said = _first_up(words.what or words.name)
    return f"{said}: {size} (1 sd)." if size and "±" in size else f"{said}{f': {size}' if size else ''}."


def how_sure(one: Found) -> str:
    """Say how sure it is that there is something, and how sure its name is."""
    said = [f"The chance that noise alone makes any cause look like this is {chance(one.p)}."]
    if one.of_family:
        kin = _first_up(listed([cause_words(name).name for name in one.kin]))
        said.append("That it goes with the joint's angle is sure; its order, or finer form, is not.")
        said += [f"{kin} would do as well."] if one.kin else []
    if one.others:
        verb = "explains" if len(one.others) == 1 else "explain"
        names = listed([other.name for other in one.others], 5)
        said.append(
            f"Its name is less sure: {names} {verb} these data as well, or nearly so (probability of "
            f"{cause_name(one.cause, one.joint)}: {sureness(one.probability)})."
        )
    elif UNEXPLAINED in one.alike:
        said.append(
            "Its name is not sure: something that no cause explains depends on the same input, and may be all of it."
        )
    elif not one.of_family:
        said.append(
            f"Nothing else that was tested explains the data nearly as well (probability {sureness(one.probability)})."
        )
    return " ".join(said)


def _apart(one: Found, tables: Tables) -> list[str]:
    """Say what would tell a cause from its rivals."""
    rows = tables["diagnose/separations.csv"]
    own = rows[(rows["cause"] == one.cause) & (rows["joint"].fillna(0) == one.joint)]
    asked = tables["diagnose/next_poses.csv"].drop_duplicates("tells")
    proposed = {
        named(text).name
        for tells, rivals in asked[["tells", "from"]].itertuples(index=False) if named(tells) == Alternative(one.cause, one.joint)
        for text in rivals.split("; ")
    }  # fmt: skip
    said = []
    for row in own.to_dict("records"):
        rival = cause_name(row["rival"], _whole(row["rival_joint"]))
        before, after = (float(row[f"separation_{when}_sd"]) for when in ("before", "after"))
        if row["chance_after"] < ENOUGH:
            said.append(f"{_first_up(named_ids(str(row['words']))).rstrip('.')}.")
            continue
        poses = "The poses of diagnose/next_poses.csv" if rival in proposed else "Further poses"
        said.append(
            f"{poses} would tell it from {rival}: {after:.1f} standard deviations apart instead of {before:.1f}."
        )
    return list(dict.fromkeys(said))[:3]


def _gain(material: Material, one: Found) -> str:
    if not _moves(material, one):
        return "It changes how much each row counts, not where the tool is predicted."
    return gain_words(one, material.noise_floor)


def gain_words(one: Found, floor: float | None) -> str:
    """Say what a cause gained on poses that no fit has seen; floor is what noise alone would leave [mm]."""
    gain, low, high = one.gain
    if math.isnan(gain):
        return "No poses were held out, so what it is worth at other poses is not known."
    interval = f"95 % interval {_signed(low)} to {_signed(high)} mm"
    noise = f"; noise alone would leave {mm(floor)} mm" if floor else ""
    if low > 0:
        return (
            f"At poses that no fit has seen it takes {mm(gain)} mm off the mean error ({interval}) and leaves {mm(one.left)} "
            f"mm{noise}."
        )
    if high < 0:
        return f"At poses that no fit has seen it makes the mean error {mm(-gain)} mm larger ({interval}): do not rely on it."
    return (
        f"At poses that no fit has seen the step that added it gained {_signed(gain)} mm, which cannot be told from nothing "
        f"({interval}); {mm(one.left)} mm are left{noise}."
    )


def _gain_cells(one: Found) -> tuple[str, str]:
    gain, low, high = one.gain
    if math.isnan(gain):
        return "–", "–"
    return _signed(gain), f"{_signed(low)} … {_signed(high)}"


def _moves(material: Material, one: Found) -> bool:
    """Whether a finding is in the model of the position, and not in that of the noise."""
    return one.told and bool((material.tables["diagnose/curves.csv"]["finding"] == one.order).any())


def _curve(material: Material, one: Found) -> list[Block]:
    rows = material.tables["diagnose/curves.csv"]
    rows = rows[(rows["finding"] == one.order) & rows["split"].isin(["train", "holdout"])]
    if rows.empty:
        return []
    x, before, after, fitted = rows[["x", "before_mm", "after_mm", "fitted_mm"]].to_numpy(dtype=float).T
    unit = "" if pd.isna(rows["variable_unit"].iloc[0]) else str(rows["variable_unit"].iloc[0])
    drawn = explained(
        x, before, after, fitted, (rows["split"] != "train").to_numpy(), str(rows["variable"].iloc[0]), unit
    )
    return [
        plot(
            f"cause_{one.order}",
            drawn,
            f"{_first_up(one.name)}: errors without it, with it, and against what it explains.",
        )
    ]


def _gained(material: Material, causes: Sequence[Found]) -> list[Block]:
    moved = [one for one in causes if math.isfinite(one.gain[0])]
    if not moved:
        return []
    before = material.tables["identify/accuracy.csv"]
    start = steps(before, split_judged(before))[-1].mean
    drawn = gains(start, _labels(moved), [one.left for one in moved], np.array([one.gain[1:] for one in moved]),
                  material.noise_floor)  # fmt: skip
    unknown = (
        "" if material.noise_floor else " What noise alone would leave is not known: it was estimated from the fit."
    )
    return [heading("What the causes gained"), plot("gains", drawn, GAINS + unknown)]


def _unexplained(left: Sequence[Found]) -> list[Block]:
    if not left:
        return []
    items = [
        (f"{_first_up(one.inputs)}:", f"part of the error depends on it, and no cause of the catalogue explains it. The chance "
         f"that noise looks like this is {chance(one.p)}.{_worth(one)}")
        for one in left
    ]  # fmt: skip
    return [
        heading("What stays unexplained"),
        bullets(items),
        paragraph("It is not in the model. Where it acts, predictions are off by more than noise."),
    ]


def _worth(one: Found) -> str:
    """Say what a Gaussian process would gain."""
    gain, low, high = one.gain
    if math.isnan(gain):
        return ""
    interval = f"95 % interval {_signed(low)} to {_signed(high)} mm"
    if low <= 0:
        return f" How much it matters at other poses cannot be told (a Gaussian process gains {_signed(gain)} mm, {interval})."
    return f" A Gaussian process of it, which has no physical meaning, would take {mm(gain)} mm off the mean error ({interval})."


def _space(material: Material, causes: Sequence[Found]) -> list[Block]:
    if not any(_moves(material, one) for one in causes):
        return []
    position, before, after = 1e3 * material.data.position, material.error_before, material.error
    shown = np.unique(np.linspace(0, len(position) - 1, DRAWN).astype(int))
    factor = magnification(position, before)
    drawn = in_space(position[shown], before[shown], after[shown], material.held[shown], factor)
    said = (
        f"Errors before and after the causes were added, both drawn {factor:,.0f} times enlarged; the darker, the larger. "
        "Circles: used for the fit; triangles: held out."
    )
    return [plot("causes_workspace", drawn, said)]


def _evidence(material: Material, causes: Sequence[Found]) -> list[Block]:
    rows = _tested(material.tables["diagnose/candidates.csv"]).head(SHOWN)
    if rows.empty:
        return []
    places = {(one.cause, one.joint) for one in causes}
    added = np.array([(row["cause"], _whole(row["joint"])) in places for row in rows.to_dict("records")])
    drawn = evidence([_candidate(row) for _, row in rows.iterrows()], -rows["delta_bic"].to_numpy(dtype=float),
                     rows["p_family"].to_numpy(dtype=float), added, WITHIN, _gate(material))  # fmt: skip
    return [heading("How the search went"), plot("evidence", drawn, EVIDENCE)]


def _limits(candidates: pd.DataFrame) -> list[Block]:
    """Tell how small a cause these data would have shown, by joint or link."""
    shown = candidates[candidates["limit"].notna()].astype({"part": object})
    if shown.empty:
        return []
    numbers = sorted({int(joint) for joint in shown["joint"].dropna()})
    least = shown.fillna({"joint": 0}).groupby(["cause", "joint"], sort=False)["limit"].min()
    rows = []
    for cause, unit in shown.drop_duplicates("cause")[["cause", "unit"]].itertuples(index=False):
        factor, said = readable_size(cause, unit)
        cells = [two_digits(factor * least[cause, k]) if (cause, k) in least.index else "–" for k in (*numbers, 0)]
        rows.append((_first_up(cause_words(cause).name), said, *cells))
    header = ("cause", "unit", *map(str, numbers), "whole robot")
    return [
        heading("How small a cause these data show"),
        paragraph(LIMITS, keep=True),
        table(header, sorted(rows), "ll" + "r" * (len(numbers) + 1), size=8, wide=0),
    ]


def _untested(candidates: pd.DataFrame) -> list[Block]:
    groups = untestable(candidates)
    if not groups:
        return []
    items = [(f"{_first_up(why)}:", f"{listed(names, 12)}.") for why, names in groups.items()]
    return [
        heading("Not testable with these data"),
        paragraph(
            "Of these causes the data say nothing, neither that they are there nor that they are not.", keep=True
        ),
        bullets(items),
    ]


def untestable(candidates: pd.DataFrame) -> dict[str, list[str]]:
    """Return why causes could not be tested, in words, and which."""
    places: dict[tuple[str, str], list[str]] = {}
    for row in candidates.astype({"note": object, "part": object}).fillna({"note": "", "part": ""}).to_dict("records"):
        why = str(row["note"]).removeprefix("not testable: ")
        if why != row["note"] and not why.startswith("needs nothing"):
            why = "the model's own parameters imitate" if "imitate" in why else why
            places.setdefault((why, str(row["cause"])), []).append(str(row["part"]))
    groups: dict[str, list[str]] = {}
    for (why, cause), parts in places.items():
        groups.setdefault(why, []).append(place_names(cause, parts))
    return groups


def _tested(candidates: pd.DataFrame) -> pd.DataFrame:
    return candidates[candidates["delta_bic"].notna()].sort_values("delta_bic", kind="stable")


def _strongest(candidates: pd.DataFrame) -> str:
    rows = _tested(candidates)
    if rows.empty:
        return ""
    best = rows.iloc[0]
    return (
        f" The strongest, {_candidate(best)}, is no more than noise alone shows in such a search: the chance of it is "
        f"{chance(float(best['p_family']))}."
    )


def _candidate(row: pd.Series) -> str:
    name = place_name(str(row["cause"]), "" if pd.isna(row["part"]) else str(row["part"]))
    detail = "" if pd.isna(row["detail"]) else f" ({row['detail']})"
    return name + detail if len(name + detail) <= LONGEST else name


def _gate(material: Material) -> float:
    """Chance of a false alarm below which a cause passes."""
    settings = material.study.validated_settings("diagnose", DiagnoseSettings)
    assert isinstance(settings, DiagnoseSettings)
    return float(SHARES["causes"] * settings.false_alarm)


def _title(one: Found) -> str:
    if one.status == "unexplained":
        return f"depends on {one.inputs}"
    return one.names


def _signed(value: float) -> str:
    return number(value, ".3f")


def _whole(value: object) -> int:
    return 0 if pd.isna(value) else int(value)  # type: ignore[call-overload]


def _labels(causes: Sequence[Found]) -> list[str]:
    """Return the causes' names, with their details where a name comes twice."""
    names = [one.name for one in causes]
    return [f"{one.name} ({one.detail})" if names.count(one.name) > 1 and one.detail else one.name for one in causes]


def _first_up(text: str) -> str:
    return text[:1].upper() + text[1:]


def lacked(tables: Tables, most: int = 4) -> list[str | tuple[str, str]]:
    """Say for the first page in a line each what the model lacked."""
    causes = [one for one in findings(tables) if one.told]
    if not causes:
        told = "No cause explains what is left" if _left(tables) else "Nothing was found"
        return [f"{told}: {item(tables['diagnose/summary.csv'], 'causes_tested')} causes were tested."]
    labels = _labels(causes)
    said: list[str | tuple[str, str]] = [
        (f"{_first_up(label)}:", _in_short(one)) for label, one in zip(labels[:most], causes[:most], strict=True)
    ]
    if len(causes) > most:
        rest = listed(list(dict.fromkeys(one.name for one in causes[most:])))
        said.append((f"And {plural(len(causes) - most, 'more cause')}:", f"{rest}."))
    return said


def _in_short(one: Found) -> str:
    gain, low, _ = one.gain
    gained = f"; it takes {mm(gain)} mm off the mean error" if math.isfinite(gain) and low > 0 else ""
    unproven = "; the step that added it shows no gain at held-out poses" if math.isfinite(gain) and low <= 0 else ""
    return f"{one.amount}{gained}{unproven}."


def unsure(tables: Tables) -> list[str]:
    """Say for the first page which names and which structure the data leave open."""
    said = []
    for one in findings(tables):
        if one.of_family:
            said.append(f"The order, or finer form, of the {one.name}.")
        if UNEXPLAINED in one.alike:
            said.append(f"Whether it is {one.name} at all, or a part of what stays unexplained.")
        elif one.status == "one_of" and one.others:
            said.append(f"Whether it is {' or '.join([one.name, *(rival.name for rival in one.others[:3])])}.")
    left = _left(tables)
    why = f"Why a part of the error depends on {structure(tables)}: no cause of the catalogue explains it."
    gain = max((one.gain[0] for one in left if one.gain[1] > 0), default=0.0)
    worth = f" What depends on it is worth {mm(gain)} mm of the mean error, or more." if gain else ""
    return [*said, why + worth] if left else said


def structure(tables: Tables) -> str:
    """Name what the unexplained part of the error depends on; empty where nothing is unexplained."""
    left = _left(tables)
    return listed([one.inputs for one in left], 3) if left else ""


def _left(tables: Tables) -> list[Found]:
    return [one for one in findings(tables) if one.status == "unexplained"]


def next_poses(tables: Tables) -> list[Advice]:
    """Poses that tell a cause from its rival are to be measured."""
    found = []
    for _, rows in tables["diagnose/next_poses.csv"].groupby(["tells", "from"], sort=False):
        first = rows.iloc[0]
        own, *others = (named(text).name for text in (first["tells"], *first["from"].split("; ")))
        apart = f"at least {first['separation_after_sd']:.1f} standard deviations apart"
        sentence = (
            f"Measure the {plural(len(rows), 'pose')} of diagnose/next_poses.csv that tell {own} from {listed(others)}: they would "
            f"be {apart} instead of {first['separation_before_sd']:.1f}.{_left_open(first['leaves_open'])}"
        )
        found.append(Advice(3, sentence))
    return found


def _left_open(pairs: object) -> str:
    if not isinstance(pairs, str) or not pairs:
        return ""
    named_pairs = [" or ".join(named(one).name for one in pair.split(" or ")) for pair in pairs.split("; ")]
    return f" They leave open whether it is {listed(named_pairs, 3)}."


def other_means(tables: Tables) -> list[Advice]:
    """Where no pose tells a cause from its rival, something else does."""
    open_ = {(one.cause, one.joint) for one in findings(tables) if one.status == "one_of"}
    means: dict[str, list[str]] = {}
    for row in tables["diagnose/separations.csv"].to_dict("records"):
        if row["chance_after"] >= ENOUGH or (row["cause"], _whole(row["joint"])) not in open_:
            continue
        pair = f"{cause_name(row['cause'], _whole(row['joint']))} from {cause_name(row['rival'], _whole(row['rival_joint']))}"
        means.setdefault(str(row["words"]).partition(": ")[2] or str(row["words"]), []).append(pair)
    return [Advice(3, f"To tell {listed(pairs, 3)}: {named_ids(what).rstrip('.')}.") for what, pairs in means.items()]


def unexplained(tables: Tables) -> list[Advice]:
    """Structure without a cause is to be looked for at the robot."""
    if not _left(tables):
        return []
    sentence = (
        f"Something depends on {structure(tables)} that no cause of the catalogue explains. Look at the robot for what changes "
        "with it (hoses and cables, loose bolts, collisions, the device's support), and measure again."
    )
    return [Advice(2, sentence)]


def makes_it_worse(tables: Tables) -> list[Advice]:
    """Causes with which unseen poses fit worse were fitted to too few poses."""
    if "diagnose/accuracy.csv" not in tables or split_judged(tables["diagnose/accuracy.csv"]) != "holdout":
        return []
    own, last = (steps(tables[f"{stage}/accuracy.csv"], "holdout")[-1].mean for stage in ("identify", "diagnose"))
    if last <= WORSE * own:
        return []
    sentence = (
        f"Do not use the model with the causes: at held-out poses it is worse than without them ({mm(last)} mm against "
        f"{mm(own)} mm). The fitted poses are too few or too alike for so many causes; measure more."
    )
    return [Advice(1, sentence)]


def untested(tables: Tables) -> list[Advice]:
    """Where something stays unexplained, what would make more causes testable is worth its while."""
    needs = {
        why.removeprefix("needs "): names
        for why, names in untestable(tables["diagnose/candidates.csv"]).items()
        if why.startswith("needs ")
    }
    if not needs or not unexplained(tables):
        return []
    said = "; ".join(f"{what} ({listed(names, 4)})" for what, names in list(needs.items())[:3])
    return [Advice(3, f"More causes could be tested with {said}.")]


SECTION = Section(
    25,
    "What the model lacked: causes",
    tuple(f"diagnose/{name}.csv" for name in ("findings", "candidates", "separations", "next_poses")),
    write,
    (makes_it_worse, unexplained, next_poses, other_means, untested),
)
