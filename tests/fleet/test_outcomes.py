"""Outcomes: the order in which they need a look, and that they read back as they were."""

from __future__ import annotations

from dataclasses import replace

from calflow.fleet.standing import Outcome, fleet_lines, read_outcome, uncalibrated_lines, worst_first, write_outcome


def outcome(robot: str, status: str = "calibrated", after: float | None = None, usable: bool | None = None) -> Outcome:
    """What came of a robot."""
    return Outcome(
        robot=robot, type="t", status=status, before_mean=after and 10 * after, after_mean=after, usable=usable
    )


def test_the_worst_robots_stand_first():
    """Fails if a robot that failed, or whose model is not to be used, stands below one that is well."""
    found = [outcome("a", after=0.1, usable=True), outcome("b", after=0.3, usable=True), outcome("c", after=0.2, usable=False),
             outcome("d", "failed"), outcome("e", "not run")]  # fmt: skip
    assert [one.robot for one in worst_first(found)] == ["d", "e", "c", "b", "a"]
    assert [one.robot for one in worst_first(found, {"a"})] == ["d", "e", "c", "a", "b"]
    assert fleet_lines(found) == [
        "3 of 5 robots calibrated; 1 failed (d); 1 not run (e); 1 with a model that is not to be used (c).",
        "Half of them have a mean position error of 0.200 mm or less (before: 2.00 mm); the worst one, b, is left with 0.300 mm.",
    ]


def test_errors_at_fitted_poses_are_called_so():
    """Fails if a plant's accuracy is that of the fit, and no word says so."""
    judged, fitted = (
        replace(outcome(name, after=0.1), judged_by=by) for name, by in (("a", "holdout"), ("b", "train"))
    )
    end = " are at the poses that were fitted, smaller than at others: hold out three poses in ten."
    assert fleet_lines([judged, fitted])[-1] == f"Errors of b{end}"
    assert fleet_lines([fitted])[-1] == f"All errors{end}"
    assert "fitted" not in "".join(fleet_lines([judged]))


def test_a_reason_of_several_robots_is_told_once():
    """Fails if a mistake in a file that a hundred robots share is a hundred times the same line."""
    found = [replace(outcome(name, "failed"), reason="robot.toml: x") for name in "abc"]
    found += [outcome("d"), replace(outcome("e", "not run"), reason="not begun")]
    assert uncalibrated_lines(found) == ["! a, b and c (t): Failed: robot.toml: x", "! e (t): Not run: not begun"]


def test_an_outcome_reads_back_as_it_was(tmp_path):
    """Fails if what came of a robot is lost on the way to the report."""
    told = Outcome(
        robot="a", type="t", status="calibrated", usable=False, after_mean_mm=0.1, causes=("play, 1 ± 1 µrad", "x")
    )
    write_outcome(tmp_path / "a.json", told)
    assert read_outcome(tmp_path / "a.json") == told
    assert read_outcome(tmp_path / "b.json") is None
