"""A finding told: what it is, how sure that is, what it gained, and its curve.

What tells a finding from its rivals: further poses, or something else at the robot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from calflow.design.discrimination import ENOUGH, NextPose, SeparationRow, no_pose_words
from calflow.diagnosis.findings.finding import Finding
from calflow.effects.words import UNEXPLAINED, cause_name, cause_words
from calflow.files.results import Results
from calflow.files.words import chance, first_up, listed, plural, sureness
from calflow.reporting.blocks import Block, Heading, Paragraph, Plot
from calflow.reporting.causes.gain import gain_words
from calflow.reporting.figures.causes import explained, in_space
from calflow.reporting.figures.residuals import magnification
from calflow.reporting.findings import findings
from calflow.reporting.material import Material
from calflow.reporting.section import Advice

TOLD = 3  # rivals that a finding's own text names


def apart(one: Finding, results: Results) -> list[str]:
    """Say what would tell a cause from its rivals."""
    said = []
    for row in _separations(results):
        if (row.cause, row.joint) != (one.cause, one.joint):
            continue
        if row.chance_after < ENOUGH:
            after = row.separation_after_sd if row.tested else None
            why = no_pose_words(cause_words(row.cause).name, cause_words(row.rival).name, after, row.unasked)
            said.append(f"{first_up(why)}: {row.means}.")
            continue
        poses = "The poses of diagnose/next_poses.csv" if row.proposed else "Further poses"
        said.append(
            f"{poses} would tell it from {cause_name(row.rival, row.rival_joint)}: {row.separation_after_sd:.1f} standard "
            f"deviations apart instead of {row.separation_before_sd:.1f}."
        )
    return list(dict.fromkeys(said))[:TOLD]


def next_poses(results: Results) -> list[Advice]:
    """Poses that tell a cause from its rival are to be measured."""
    plans: dict[tuple[object, ...], list[NextPose]] = {}
    for pose in results.rows("diagnose/next_poses.csv", NextPose):
        plans.setdefault((pose.cause, pose.joint, pose.rival_causes, pose.rival_joints), []).append(pose)
    found = []
    for poses in plans.values():
        first = poses[0]
        own, others = cause_name(first.cause, first.joint), _names(first.rival_causes, first.rival_joints)
        sentence = (
            f"Measure the {plural(len(poses), 'pose')} of diagnose/next_poses.csv that tell {own} from {listed(others)}: they "
            f"would be at least {first.separation_after_sd:.1f} standard deviations apart instead of "
            f"{first.separation_before_sd:.1f}.{_left_open(first)}"
        )
        found.append(Advice(3, sentence))
    return found


def other_means(results: Results) -> list[Advice]:
    """Where no pose tells a cause from its rival, something else does."""
    open_ = {(one.cause, one.joint) for one in findings(results) if one.status == "one_of"}
    means: dict[str, list[str]] = {}
    for row in _separations(results):
        if row.chance_after < ENOUGH and (row.cause, row.joint) in open_:
            own, rival = cause_name(row.cause, row.joint), cause_name(row.rival, row.rival_joint)
            means.setdefault(row.means, []).append(f"{own} from {rival}")
    return [Advice(3, f"To tell {listed(pairs, 3)}: {what}.") for what, pairs in means.items()]


def _separations(results: Results) -> list[SeparationRow]:
    return results.rows("diagnose/separations.csv", SeparationRow)


def _left_open(pose: NextPose) -> str:
    first = _names(pose.open_causes, pose.open_joints)
    second = _names(pose.open_other_causes, pose.open_other_joints)
    pairs = [" or ".join(pair) for pair in zip(first, second, strict=True)]
    return f" They leave open whether it is {listed(pairs, 3)}." if pairs else ""


def _names(causes: tuple[str, ...], joints: tuple[int, ...]) -> list[str]:
    return [cause_name(cause, joint) for cause, joint in zip(causes, joints, strict=True)]


WANDERED = "What the device reports shifts in the course of the measurement"
DRAWN = 700  # arrows in the workspace


def finding(material: Material, one: Finding, number: int) -> list[Block]:
    """Tell a cause, the number of which counts those found, in words and figures."""
    head = f"{number}. {first_up(one.names)}"
    text = " ".join(
        part for part in (_what(one), how_sure(one), *apart(one, material.results), _gain(material, one)) if part
    )
    return [Heading(head), Paragraph(text), *_curves(material, one)]


def _what(one: Finding) -> str:
    words = cause_words(one.cause)
    size = f"{words.size} {one.amount}" if one.unit else ""
    if one.of_family:
        best = f"{words.name} ({one.detail})" if one.detail else words.name
        off = f"The angle of joint {one.joint} is off by an amount that goes with the angle" if one.joint else WANDERED
        return f"{off}; best described as {best}: {size}."
    said = first_up(words.what or words.name)
    return f"{said}: {size} (1 sd)." if size and "±" in size else f"{said}{f': {size}' if size else ''}."


def how_sure(one: Finding) -> str:
    """Say how sure it is that there is something, and how sure its name is."""
    said = [f"The chance that noise alone makes any cause look like this is {chance(one.p_family)}."]
    if one.of_family:
        kin = first_up(listed([cause_words(name).name for name in one.kin]))
        sure = "That it goes with the joint's angle is sure; its order, or finer form, is not."
        said.append(sure if one.joint else "That it goes with the time is sure; its course is not.")
        said += [f"{kin} would do as well."] if one.kin else []
    if one.others:
        named = [other for other in one.others if other.cause != UNEXPLAINED]
        tested = [other.name for other in named if other.cause not in one.not_tested]
        untested = [other.name for other in named if other.cause in one.not_tested]
        verb = "explains" if len(tested) == 1 else "explain"
        why = [f"{listed(tested, 5)} {verb} these data as well, or nearly so"] if tested else []
        why += [f"{listed(untested, 5)} could not be tested with these data"] if untested else []
        why += ["something that no cause explains may be all of it"] if len(named) < len(one.others) else []
        said.append(
            f"Its name is less sure: {', and '.join(why)} (probability of {cause_name(one.cause, one.joint)}: "
            f"{sureness(one.probability)})."
        )
    elif UNEXPLAINED in one.cannot_tell_from:
        said.append(
            "Its name is not sure: something that no cause explains depends on the same input, and may be all of it."
        )
    elif not one.of_family:
        said.append(
            f"Nothing else that was tested explains the data nearly as well (probability {sureness(one.probability)})."
        )
    if one.carries_over is False:
        said.append("It does not hold in blocks of the fitted poses that were left out: do not rely on its name.")
    return " ".join(said)


def _gain(material: Material, one: Finding) -> str:
    if not moves(material, one):
        return "It changes how much each row counts, not where the tool is predicted."
    return gain_words(one, material.noise_floor)


def moves(material: Material, one: Finding) -> bool:
    """Whether a finding is in the model of the position, and not in that of the noise."""
    return one.is_cause and bool((material.tables["diagnose/curves.csv"]["finding"].isin(one.numbers)).any())


def _curves(material: Material, one: Finding) -> list[Block]:
    every = material.tables["diagnose/curves.csv"]
    drawn = [every[(every["finding"] == number) & every["split"].isin(["train", "holdout"])] for number in one.numbers]
    return [_curve(one, rows, number) for rows, number in zip(drawn, one.numbers, strict=True) if not rows.empty]


def _curve(one: Finding, rows: pd.DataFrame, number: int) -> Block:
    x, before, after, fitted = rows[["x", "before_mm", "after_mm", "fitted_mm"]].to_numpy(dtype=float).T
    unit = "" if pd.isna(rows["variable_unit"].iloc[0]) else str(rows["variable_unit"].iloc[0])
    drawn = explained(
        x, before, after, fitted, (rows["split"] != "train").to_numpy(), str(rows["variable"].iloc[0]), unit
    )
    said = one.name if len(one.numbers) == 1 else cause_name(str(rows["cause"].iloc[0]), one.joint)
    caption = f"{first_up(said)}: errors without it, with it, and against what it explains."
    told = rows[["variable", "variable_unit", "x", "before_mm", "after_mm", "fitted_mm", "split"]]
    return Plot(f"cause_{number}", drawn, caption, told)


def space(material: Material, causes: Sequence[Finding]) -> list[Block]:
    """Draw the errors before and after the causes were added."""
    if not any(moves(material, one) for one in causes):
        return []
    position, before, after = 1e3 * material.place, material.error_before, material.error
    whole = np.isfinite(before).all(axis=1)
    if not whole.any():
        return []
    position, before, after, held = position[whole], before[whole], after[whole], material.held[whole]
    shown = np.unique(np.linspace(0, len(position) - 1, DRAWN).astype(int))
    factor = magnification(position, before)
    drawn = in_space(position[shown], before[shown], after[shown], held[shown], factor)
    said = (
        f"Errors before and after the causes were added, both drawn {factor:,.0f} times enlarged; the darker, the larger. "
        "Circles: used for the fit; triangles: held out."
    )
    columns = {f"{name}_{axis}_mm": values[:, k] for name, values in (("at", position), ("before", before), ("after", after))
               for k, axis in enumerate("xyz")}  # fmt: skip
    return [Plot("causes_workspace", drawn, said, pd.DataFrame({**columns, "held_out": held}))]
