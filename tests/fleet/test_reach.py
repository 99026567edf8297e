"""The fleet file of a stranger: what it may name, what it may be called, and where its folder may lie."""

from __future__ import annotations

import shutil

import pytest

from fleet.plant import FLEET, Plant


def refused(plant: Plant, *options: object) -> str:
    """What is said of a fleet that must be refused before anything is written."""
    for command in ("plan", "run", "report"):
        answer = plant.fleet(command, *options)
        assert answer.code == 2, answer
        assert "Traceback" not in answer.err
    assert not plant.out.exists()
    return answer.err


@pytest.fixture
def secret(tmp_path):
    """A file of the user's outside of the fleet's folder, which could be read as a study, a workflow or rows."""
    path = tmp_path / "elsewhere" / "passwords.toml"
    path.parent.mkdir()
    path.write_text('sesame = "open"\n', encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("data/{robot}/measurements.csv", "{folder}/{robot}.toml"),
        ("data/{robot}/measurements.csv", "../elsewhere/{robot}.toml"),
        ("type/study.toml", "../elsewhere/passwords.toml"),
        ('"type/study.toml"', '"type/study.toml"\nrobot = "../elsewhere/passwords.toml"'),
        ('"small"', '"small"\ndata = "../elsewhere/passwords.toml"'),
    ],
)
def test_a_fleet_file_names_nothing_outside_of_its_folder(plant, secret, old, new):
    """Fails if a fleet file can have any file of the user's read, and messages then quote it."""
    text = FLEET + '\n[robots.A-1]\ntype = "small"\n'
    assert old in text
    plant.file.write_text(text.replace(old, new.replace("{folder}", str(secret.parent))), encoding="utf-8")
    told = refused(plant)
    assert "leads out of the fleet file's folder" in told
    assert "sesame" not in told


@pytest.mark.parametrize(
    ("old", "new"), [("quick.toml", "../../elsewhere/passwords.toml"), ("robot.toml", "linked.toml")]
)
def test_a_types_study_names_nothing_outside_either(plant, secret, old, new):
    """Fails if a study's workflow or robot file leads out of the fleet's folder, be it by a link."""
    study = plant / "type" / "study.toml"
    study.write_text(study.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    (plant / "type" / "linked.toml").symlink_to(secret)
    told = refused(plant)
    assert "leads out of the fleet file's folder" in told
    assert "sesame" not in told


def test_a_robots_file_that_is_a_link_is_not_read(plant, secret):
    """Fails if what a link in the fleet's folder names is read."""
    plant.measurements("B-2").unlink()
    plant.measurements("B-2").symlink_to(secret)
    assert f"robot 'B-2': leads out of the fleet file's folder, to {secret}" in refused(plant)


@pytest.mark.parametrize("name", ["/tmp/x", "../x", "a/b", ".hidden", ""])
def test_a_types_name_is_a_name(plant, name):
    """Fails if a type is called as a path is, and what is known of it is written there."""
    plant.file.write_text(FLEET.replace("[types.small]", f"[types.'{name}']"), encoding="utf-8")
    assert "expected letters, digits" in refused(plant)


def test_a_link_in_a_fleets_folder_is_not_written_through(plant, tmp_path):
    """Fails if a fleet's log, study or run goes where a link in the fleet's folder leads."""
    for name in ("logs", "studies", "outcomes", ".snakemake", "snakemake.log"):
        (tmp_path / "elsewhere").mkdir(exist_ok=True)
        plant.out.mkdir()
        (plant.out / name).symlink_to(tmp_path / "elsewhere")
        answer = plant.fleet("run", "--cores", 1)
        assert answer.code == 2, answer
        assert f"{plant.out / name}" in answer.err
        assert "leads out of the folder" in answer.err
        assert not list((tmp_path / "elsewhere").iterdir())
        shutil.rmtree(plant.out)
