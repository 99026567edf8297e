"""The manifest: nothing outside the run folder is touched, and nothing that no run wrote is believed."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

from calflow.files.problems import InputError
from calflow.files.writing import contained
from calflow.run_folder import read_manifest

COMMANDS = {"run": [], "plan": [], "status": ["runs"], "predict": ["runs", "measurements.csv"], "report": []}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    "name", ["../study.toml", "identify/../../study.toml", "{}/study.toml", "C:study.toml", "..\\study.toml"]
)
def test_outputs_outside_the_folder_are_refused_by_name(finished, command, name):
    """Fails if a manifest makes a run delete or read what is not its own."""
    name = name.format(finished.path)
    before = (finished / "study.toml").read_bytes()
    finished.vouch(lambda manifest: manifest["stages"]["identify"]["outputs"].update({name: "0"}))
    (told,) = finished.refused(command, *(finished / part for part in COMMANDS[command]))
    assert told.startswith("runs/manifest.json: names ")
    assert "study.toml" in told
    assert "no file inside the run folder" in told
    assert (finished / "study.toml").read_bytes() == before


def test_a_link_out_of_the_folder_is_refused(finished, tmp_path):
    """Fails if a run reads, or later deletes, files elsewhere through a folder that is a link."""
    (finished / "runs" / "identify").rename(tmp_path / "elsewhere")
    (finished / "runs" / "identify").symlink_to(tmp_path / "elsewhere")
    before = sorted(path.name for path in (tmp_path / "elsewhere").iterdir())
    assert all("runs/manifest.json: names 'identify/" in told for told in finished.refused("run", "--force"))
    assert sorted(path.name for path in (tmp_path / "elsewhere").iterdir()) == before


def test_a_work_folder_that_is_a_link_is_refused(finished, tmp_path):
    """Fails if a fresh start empties a folder elsewhere."""
    (tmp_path / "elsewhere" / "identify").mkdir(parents=True)
    (tmp_path / "elsewhere" / "identify" / "mine.txt").write_text("mine", encoding="utf-8")
    (finished / "runs" / ".partial").symlink_to(tmp_path / "elsewhere")
    (told,) = finished.refused("run", "--stage", "identify", "--force")
    assert told.startswith("runs/.partial/identify: leads out of the folder")
    assert (tmp_path / "elsewhere" / "identify" / "mine.txt").exists()


def test_a_run_folder_may_be_a_link_itself(finished, tmp_path):
    """Fails if results on another disk, linked to, are refused."""
    (finished / "runs").rename(tmp_path / "large-disk")
    (finished / "runs").symlink_to(tmp_path / "large-disk")
    assert finished.calflow("run", "--out", tmp_path / "large-disk").code == 0
    assert finished.calflow("run").code == 0


@pytest.mark.parametrize(
    ("name", "good"),
    [("a/b.csv", True), ("a", True), ("", False), ("/a", False), ("a//b", False), (".", False), ("a\0", False)],
)
def test_which_names_lie_in_a_folder(tmp_path, name, good):
    """Fails if a name is judged by how it looks on this system only."""
    assert (contained(tmp_path, name) is not None) == good


WRONG = {
    "a number as status": lambda m: m["stages"]["identify"].update(status=3),
    "a status there is not": lambda m: m["stages"]["identify"].update(status="dune"),
    "a list of outputs": lambda m: m["stages"]["identify"].update(outputs=["identify/accuracy.csv"]),
    "a number as hash": lambda m: m["stages"]["identify"]["outputs"].update({"identify/accuracy.csv": 3}),
    "no outputs of what is done": lambda m: m["stages"]["identify"].pop("outputs"),
    "a text as key": lambda m: m["stages"]["identify"].update(key="code"),
    "a text as seconds": lambda m: m["stages"]["identify"].update(seconds="long"),
    "a list of inputs": lambda m: m.update(inputs=[]),
    "a number as study": lambda m: m.update(study=1),
    "no study file": lambda m: m.pop("study_file"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG)
def test_values_of_other_types_are_refused(finished, command, change):
    """Fails if a manifest that no run wrote ends in a traceback, or passes for one."""
    finished.vouch(change)
    (told,) = finished.refused(command, *(finished / part for part in COMMANDS[command]))
    assert told.startswith("runs/manifest.json: is not what a run writes (")
    assert told.endswith("delete it to run everything anew")


def test_turned_bits_are_refused(finished):
    """Fails if a manifest with a turned bit passes, unless it says the same, or raises anything but a refusal."""
    path = finished / "runs" / "manifest.json"
    whole, manifest = path.read_bytes(), read_manifest(finished / "runs")
    rng = np.random.default_rng(1)
    for _ in range(300):
        content = bytearray(whole)
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)
        with contextlib.suppress(InputError):
            assert read_manifest(finished / "runs") == manifest


def test_an_earlier_version_s_manifest_is_read(finished):
    """Fails if results that state no sum of themselves are lost."""
    manifest = read_manifest(finished / "runs")
    finished.vouch(lambda _: None)
    assert read_manifest(finished / "runs") == manifest


@pytest.mark.parametrize("name", ["study.toml", "robot.toml", "workflow.toml"])
def test_changed_copies_of_the_inputs_are_told(finished, name):
    """Fails if a run is used with another separator, seed or robot than its results are of, or a lost copy is a traceback."""
    copy = finished / "runs" / "inputs" / name
    before = copy.read_bytes()
    copy.write_bytes(before + b"#\n")
    (told,) = finished.refused("predict", finished / "runs", finished / "measurements.csv")
    assert told == f"runs/inputs/{name}: is not what the run read; run the study again"
    copy.unlink()
    (told,) = finished.refused("predict", finished / "runs", finished / "measurements.csv")
    assert told == f"runs/inputs/{name}: is missing; run the study again"
    assert finished.calflow("run").code == 0
    assert copy.read_bytes() == before


def test_a_manifest_that_is_no_file_is_refused(finished):
    """Fails if a folder in its place ends in a traceback."""
    path = Path(finished / "runs" / "manifest.json")
    path.unlink()
    path.mkdir()
    (told,) = finished.refused("run")
    assert told == "runs/manifest.json: is no file; delete it to run everything anew"
