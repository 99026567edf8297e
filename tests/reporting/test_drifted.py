"""Words of a drift check: what moved, since when, the smallest recalibration, and the poses that would settle it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calflow.deployment import drift as verdict
from calflow.deployment.drift import CheckedPose, Drift, DriftSummary, Moved, Recalibrated, SettlingPose
from calflow.reporting.drift_report import drift_lines, seen_from

SUMMARY = DriftSummary(
    status="moved", false_alarm=0.01, family_p=1e-9, unexplained_p=0.5, poses=8, sessions=1, station="known",
    error_mm=0.25, left_mm=0.08, expected_mm=0.09, unseen_mm=0.1, usual_mm=2.0, chance=None,
)  # fmt: skip


def told(rivals: tuple[str, ...], since: str, before: str, chance: float | None, sessions: int = 3) -> str:
    """What is said of a zero that moved by 0.1 mrad."""
    moved = Moved(
        movement="joint2.zero", kind="zero", meaning="zero of joint 2", joint=2, probability=0.97, cannot_tell_from=rivals, p=1e-9,
        since=since, before=before,
    )  # fmt: skip
    shift = Recalibrated(
        movement="joint2.zero", symbol="zero", unit="rad", shift=1e-4, sd=1e-5, parameter="joint2.theta"
    )
    other = verdict.TestedMovement(
        movement="joint2.s", kind="cause", meaning="compliance of joint 2", joint=2, units=("rad/(Nm)",), shifts=(1e-8,),
        sds=(1e-9,), p=1e-8, probability=0.03, limits=(1e-8,),
    )  # fmt: skip
    pose = SettlingPose(readings={"q1_deg": 1.0}, payload="full", marker="E")
    summary = replace(SUMMARY, sessions=sessions, chance=chance)
    return " ".join(drift_lines(Drift((moved,), (shift,), (other,), (), (pose,) * 4, summary)))


@pytest.mark.parametrize(
    ("rivals", "since", "before", "chance", "sessions", "words"),
    [
        ((), "May", "April", None, 3, "changed by 0.100 ± 0.010 mrad, since May (not yet in April)."),
        ((), "", "", None, 3, "changed by 0.100 ± 0.010 mrad, in all 3 sessions."),
        ((), "", "", None, 1, "changed by 0.100 ± 0.010 mrad. The check poses are off by 0.250 mm on average"),
        ((), "", "", None, 1, "0.080 mm is left once that is corrected (recalibration.csv)."),
        ((), "", "", None, 1, "4 further poses (next_poses.csv), measured and added to these rows, would show more precisely"),
        (("joint2.s",), "", "", 0.98, 1, "may instead be a change of: compliance of joint 2"),
        (("joint2.s",), "", "", 0.98, 1, "would exclude the wrong ones with a chance of 98 %."),
    ],
)  # fmt: skip
def test_the_verdict_says_since_when_what_to_correct_and_what_would_settle_it(
    rivals, since, before, chance, sessions, words
):
    """Fails if dates, the correction, rivals in words that a user has, or the poses that settle it are not told."""
    assert words in told(rivals, since, before, chance, sessions)


def test_a_joint_whose_shift_no_size_reveals_is_told_as_that():
    """Fails if a limit of half a turn, or none, reads as if any shift were found."""
    zeros = tuple(
        verdict.TestedMovement(
            movement=f"joint{joint}.zero", kind="zero", meaning="", joint=joint, units=("rad",), shifts=(0.0,), sds=(1.0,), p=1.0,
            probability=0.0, limits=(limit,),
        )
        for joint, limit in ((1, float("inf")), (2, 8.4e-5), (3, 2.2))
    )  # fmt: skip
    assert seen_from(Drift((), (), zeros, (), (), SUMMARY)) == (
        "A shift of a joint's zero would be found in 95 of 100 checks from this size on: joint 2: 0.084 mrad. No shift of joints 1 "
        "and 3 would be found."
    )


def test_the_error_is_of_the_kind_that_was_expected():
    """Fails if a mean error, which is always the smaller one, is held against an RMS error that was expected."""
    rows = tuple(CheckedPose(pose=str(k), marker="E", session="", error_mm=error, expected_mm=0.09, left_mm=error)
                 for k, error in enumerate((0.1, 0.7)))  # fmt: skip
    still = replace(SUMMARY, status="in place", error_mm=0.4)
    told = " ".join(drift_lines(Drift((), (), (), rows, (), still)))
    assert "off by an RMS error of 0.500 mm; 0.090 mm was expected if nothing had moved." in told
