"""A robot's study: its type's, with its own name and measurements."""

from __future__ import annotations

from calflow.fleet.fleet import load_fleet, write_robot_study
from calflow.study import load_study


def written(plant, name="A-1"):
    """A robot's study, written far from its type's and read."""
    write_robot_study(load_fleet(plant.file).robot(name), plant / "some" / "where" / "study.toml")
    return load_study(plant / "some" / "where" / "study.toml")


def edit(plant, old, new):
    """Replace a piece of the type's study."""
    file = plant / "type" / "study.toml"
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")


def test_a_robot_is_asked_what_its_type_is(plant):
    """Fails if a setting of the type's study is lost, or a file is not found from where the robot's study lies."""
    edit(plant, "[split]", "tracker_m = [3, 0, 1]\n\n[split]")
    study, shared = written(plant), load_study(plant / "type" / "study.toml")
    own = {"name", "title", "robot", "workflow", "measurements"}
    assert study.file.model_dump(exclude=own) == shared.file.model_dump(exclude=own)
    assert (study.name, study.robot, study.workflow) == ("A-1", shared.robot, shared.workflow)
    assert [path.resolve() for path in study.measurement_paths] == [plant.measurements("A-1")]
    assert study.file.sources[0].tracker == shared.file.sources[0].tracker
    assert len(study.measurements()) == 80


def test_the_files_of_another_robot_are_not_looked_for(plant):
    """Fails if the hash or the address of the study's own file is held against a robot's."""
    edit(
        plant, 'file = "measurements.csv"', f'file = "m.csv"\nurl = "https://example.org/m.csv"\nsha256 = "{"0" * 64}"'
    )
    assert [path.resolve() for path in written(plant).measurement_paths] == [plant.measurements("A-1")]


def test_every_series_has_its_file(plant):
    """Fails if series of a study are exchanged, or all are read from one file."""
    edit(plant, '[measurements]\nfile = "measurements.csv"',
         '[[measurements]]\nname = "a"\nfile = "a.csv"\n[[measurements]]\nname = "b"\nfile = "b.csv"')  # fmt: skip
    text = plant.file.read_text(encoding="utf-8")
    plant.file.write_text(
        text.replace('"data/{robot}/m', '["data/{robot}/m').replace('csv"', 'csv", "data/{robot}/second.csv"]')
    )
    sources = written(plant).file.sources
    assert [source.name for source in sources] == ["a", "b"]
    assert [source.file for source in sources] == ["../../data/A-1/measurements.csv", "../../data/A-1/second.csv"]


def test_a_type_may_have_a_robot_file_of_its_own(plant):
    """Fails if one study cannot serve types whose robots differ."""
    text = (plant / "type" / "robot.toml").read_text(encoding="utf-8")
    (plant / "larger.toml").write_text(text.replace("d_mm = 500", "d_mm = 600"), encoding="utf-8")
    fleet = plant.file.read_text(encoding="utf-8")
    plant.file.write_text(fleet.replace("[types.small]", '[types.small]\nrobot = "larger.toml"'), encoding="utf-8")
    assert written(plant).robot == load_fleet(plant.file).types[0].study.robot
    assert written(plant).robot.name == "small"
    assert written(plant).robot_path.resolve() == plant / "larger.toml"
