"""What tells a finding from its rivals: further poses, or something else at the robot."""

from __future__ import annotations

from calflow.design.isolability.discrimination import ENOUGH, NextPose, SeparationRow, no_pose_words
from calflow.files.results import Results
from calflow.reporting.findings import Found, cause_name, cause_words, findings
from calflow.reporting.section import Advice
from calflow.reporting.words import first_up, listed, plural

TOLD = 3  # rivals that a finding's own text names


def apart(one: Found, results: Results) -> list[str]:
    """Say what would tell a cause from its rivals."""
    said = []
    for row in _separations(results):
        if (row.cause, row.joint or 0) != (one.cause, one.joint):
            continue
        if row.chance_after < ENOUGH:
            after = row.separation_after_sd if row.tested else None
            why = no_pose_words(cause_words(row.cause).name, cause_words(row.rival).name, after, row.unasked)
            said.append(f"{first_up(why)}: {row.means}.")
            continue
        poses = "The poses of diagnose/next_poses.csv" if row.proposed else "Further poses"
        said.append(
            f"{poses} would tell it from {cause_name(row.rival, row.rival_joint or 0)}: {row.separation_after_sd:.1f} standard "
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
        own, others = cause_name(first.cause, first.joint or 0), _names(first.rival_causes, first.rival_joints)
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
        if row.chance_after < ENOUGH and (row.cause, row.joint or 0) in open_:
            own, rival = cause_name(row.cause, row.joint or 0), cause_name(row.rival, row.rival_joint or 0)
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
