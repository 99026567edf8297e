"""The fleet file: which robots there are, and every mistake in it told at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from calflow.fleet.fleet import load_fleet
from calflow.fleet.fleet_file import robots_of
from fleet.plant import FLEET, ROBOTS, Plant


def refused(plant: Plant) -> list[str]:
    """The problems of a plan that must be refused, without the plant's folder."""
    answer = plant.fleet("plan")
    assert answer.code == 2
    assert "Traceback" not in answer.err
    assert not plant.out.exists()
    return answer.err.replace(f"{plant.path}/", "").splitlines()


def test_robots_are_found_by_their_types_pattern(plant):
    """Fails if a robot that was measured is not found, or has another's file."""
    found = load_fleet(plant.file).robots
    assert tuple(robot.name for robot in found) == ROBOTS
    assert [robot.data for robot in found] == [(plant.measurements(name),) for name in ROBOTS]


def test_a_robot_that_is_named_has_files_of_its_own(plant):
    """Fails if a robot's own file is passed over, one that is found too is there twice, or one without a file is not there."""
    with plant.file.open("a", encoding="utf-8") as file:
        file.write('[robots.A-1]\ntype = "small"\ndata = "again.csv"\n[robots.D-4]\ntype = "small"\n')
    found = {robot.name: robot.data for robot in load_fleet(plant.file).robots}
    assert list(found) == [*ROBOTS, "D-4"]
    assert found["A-1"] == (plant / "again.csv",)
    assert found["D-4"] == (plant.measurements("D-4"),)
    assert "D-4  small  would fail: " in plant.fleet("plan").out


def test_a_plan_tells_whose_rows_are_at_fault(plant):
    """Fails if a misspelt column is found out in the night only, or told in full of each robot that has it."""
    for name in ROBOTS[1:]:
        rows = plant.measurements(name)
        rows.write_text(rows.read_text(encoding="utf-8").replace("y_mm", "y_mmm", 1), encoding="utf-8")
    first, *failing = [line for line in plant.fleet("plan").out.splitlines() if "would fail: " in line]
    assert first.startswith(ROBOTS[1])
    assert "unknown column 'y_mmm'" in first
    assert [line.split() for line in failing] == [
        [name, "small", "would", "fail:", "as", ROBOTS[1]] for name in ROBOTS[2:]
    ]


@pytest.mark.parametrize(
    ("pattern", "files", "names"),
    [
        ("{robot}.csv", ["a.csv", "b c.csv", "d.txt"], ["a", "b c"]),
        ("x/{robot}/{robot}.csv", ["x/a/a.csv", "x/a/b.csv"], ["a"]),
        ("[1]/{robot}.csv", ["[1]/a.csv", "1/b.csv"], ["a"]),
    ],
)
def test_a_pattern_means_what_it_says(tmp_path: Path, pattern, files, names):
    """Fails if a name that stands twice may differ, or letters that mean something to a shell do so here."""
    for name in files:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert robots_of(pattern, tmp_path) == names


def test_all_mistakes_are_told_at_once_with_their_lines(plant):
    """Fails if a mistake hides another, or is told without its line and the nearest name."""
    plant.file.write_text(
        FLEET.replace("title", "titel").replace("data/{robot}", "data/robot") + '\n[robots.X]\ntyp = "small"\n',
        encoding="utf-8",
    )
    told = refused(plant)
    assert told == [
        "plant.toml:3: fleet.titel: unknown key, did you mean 'title'?",
        "plant.toml:7: types.small.data: expected {robot} where the robot's name stands, found 'data/robot/measurements.csv'",
        "plant.toml:9: robots.X: missing: expected 'type'",
        "plant.toml:10: robots.X.typ: unknown key, did you mean 'type'?",
    ]


def test_types_and_their_studies_are_checked_before_any_robot(plant):
    """Fails if a type that is not there, or a study that does not suit, is found out robot by robot, at night."""
    with plant.file.open("a", encoding="utf-8") as file:
        file.write('[types.other]\nstudy = "no.toml"\n[robots.X]\ntype = "smal"\n[robots.Y]\ntype = "other"\n')
    study = plant / "type" / "study.toml"
    wrong = study.read_text(encoding="utf-8").replace("seed = 7", "sed = 7").replace('"robot.toml"', '"robt.toml"')
    study.write_text(wrong, encoding="utf-8")
    assert refused(plant) == [
        "type/study.toml: missing: expected 'seed'",
        "type/study.toml:4: sed: unknown key, did you mean 'seed'?",
        "type/robt.toml: no such file, did you mean 'robot.toml'?",
        f"plant.toml:9: types.other.study: there is no file {plant / 'no.toml'}".replace(f"{plant.path}/", ""),
        "plant.toml:11: robots.X.type: unknown type 'smal'; there are small, other, did you mean 'small'?",
        "plant.toml:12: robots.Y: missing: expected 'data', here or in [types.other]",
    ]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("seed = 7", 'seed = 7\nconfirm = "other.toml"', "there is no file"),
        ('stages = ["identify"]', 'stages = ["select"]', "lacks the stage identify"),
    ],
)
def test_a_study_that_only_one_robot_can_have_is_refused(plant, old, new, told):
    """Fails if what is one robot's alone is asked of all."""
    for name in ("study.toml", "quick.toml"):
        file = plant / "type" / name
        file.write_text(file.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    assert told in refused(plant)[0]


def test_a_fleet_without_robots_is_refused(plant):
    """Fails if a misspelt pattern makes a fleet of none, which is done at once."""
    plant.file.write_text(FLEET.replace("data/{", "date/{"), encoding="utf-8")
    assert "plant.toml:5: types: has no robots" in refused(plant)[0]


def test_a_robot_has_a_file_for_each_series_of_its_study(plant):
    """Fails if a series that nobody gave is taken from another robot."""
    plant.file.write_text(
        FLEET.replace('data = "data/{robot}/measurements.csv"', 'data = ["data/{robot}/measurements.csv", "{robot}"]')
    )
    told = refused(plant)
    assert len(told) == len(ROBOTS)
    assert told[0].startswith("plant.toml:7: types.small.data: robot 'A-1': expected 1 in 'data'")
