"""Check poses of a run: chosen of those that were measured, with what they would show."""

from __future__ import annotations

import pandas as pd

from applied import choose_check_poses, drift


def test_chosen_poses_are_those_of_the_file_and_their_limits_are_told(finished):
    """Fails if a pose is chosen that nobody measured, or the limits said beforehand are not those of a check by these poses."""
    measured = pd.read_csv(finished / "measurements.csv")
    answer = finished.calflow(
        "check-poses", finished / "runs", finished / "measurements.csv", "--number", 6, "--out", finished / "chosen.csv"
    )
    assert answer.code == 0
    assert "95 of 100" in answer.err
    chosen = pd.read_csv(finished / "chosen.csv", dtype={"pose": str})
    assert chosen["pose"].nunique() == 6
    readings = [name for name in chosen if name.startswith("q")]
    of_file = measured.assign(pose=measured["pose"].astype(str)).drop_duplicates("pose").set_index("pose")
    pd.testing.assert_frame_equal(
        chosen.drop_duplicates("pose").set_index("pose")[readings],
        of_file.loc[chosen["pose"].unique(), readings],
        atol=1e-3,
    )
    found = choose_check_poses(finished / "runs", finished / "measurements.csv", 6)
    assert found.foreseen.summary.status == "in place"
    again = measured[measured["pose"].astype(str).isin(chosen["pose"])].drop_duplicates(["pose", "marker"])
    finished.measure(again, "again.csv")
    told = drift(finished / "runs", finished / "again.csv", station="known")
    limits = [
        {one.movement: one.limits[0] for one in result.candidates if one.kind == "zero"}
        for result in (found.foreseen, told)
    ]
    assert limits[0].keys() == limits[1].keys()
    for name, size in limits[0].items():
        assert abs(limits[1][name] - size) < 0.2 * size


def test_more_poses_than_there_are_are_refused(finished):
    """Fails if the wish for too many poses, or for two, ends otherwise than with a message."""
    for number in (2, 1000):
        answer = finished.calflow("check-poses", finished / "runs", finished / "measurements.csv", "--number", number)
        assert answer.code == 2
        assert "expected 3 to" in answer.err
