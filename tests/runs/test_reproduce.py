"""Reproduction: the same bytes from a run's own inputs, or which of them are not there, or what differs and by how much."""

from __future__ import annotations

import io
import shutil
import zipfile

import pandas as pd
import pytest

from calflow.run_folder import laid_out, read_manifest
from calflow.runs.reproduce import reproduce
from conftest import Folder, without_data


@pytest.fixture(scope="module")
def _identified(_measured, tmp_path_factory):
    folder = _measured.copied(tmp_path_factory.mktemp("identified") / "study")
    with without_data():
        assert folder.calflow("run", "--stage", "identify").code == 0
    return folder


@pytest.fixture
def identified(_identified, tmp_path, monkeypatch):
    """A study of its own for the test, with a run that ends with identify."""
    monkeypatch.delenv("CALFLOW_DATA", raising=False)
    return _identified.copied(tmp_path / "identified")


def test_a_moved_run_comes_out_the_same(finished):
    """Fails if a result depends on where a run lies or on anything but its inputs, or a difference is told where there is none."""
    answer = finished.calflow("reproduce", finished / "runs")
    assert answer.code == 0, answer
    n = sum(len(entry.outputs) for entry in read_manifest(finished / "runs").stages.values())
    assert answer.out.endswith(f"the same: all {n} files have the same bytes\n")


def test_inputs_that_changed_or_are_gone_are_all_named(finished):
    """Fails if a run is repeated with other inputs, or only the first that is wrong is told."""

    def made_elsewhere(manifest):
        for one in manifest["files"].values():
            one["path"] = one["path"].replace(manifest["folder"].removesuffix("/runs"), "/gone")
        manifest |= {"folder": "/gone/runs", "study_file": "/gone/study.toml"}

    finished.vouch(made_elsewhere)
    finished.edit("measurements.csv", ("1", "2"))
    (finished / "runs" / "inputs" / "robot.toml").unlink()
    (finished / "robot.toml").unlink()
    robot, measured = finished.refused("reproduce", finished / "runs")
    assert robot.startswith("runs: robot.toml: is missing: it was /gone/robot.toml")
    assert measured.startswith("runs: measurements.csv: has changed since the run, at ")


def test_stages_of_other_inputs_are_told(finished):
    """Fails if a run of which only a part was made again after an edit counts as one that can be repeated."""
    finished.edit("study.toml", ("seed = 7", "seed = 8"))
    assert finished.calflow("run", "--stage", "identify").code == 0
    told = finished.refused("reproduce", finished / "runs")
    assert [one.split(" ")[0] for one in told] == ["select", "sample"]
    assert all("study's seed changed from 7 to 8" in one for one in told)


def test_what_differs_is_told_with_its_size(identified):
    """Fails if another number passes for the same, or by how much is wrong."""
    table = pd.read_csv(identified / "runs" / "identify" / "parameters.csv")
    k = int(table.index[table["parameter"] == "joint2.a"][0])
    table.loc[k, "estimate"] += 3 * table.loc[k, "sd"]
    table["estimate"] = table["estimate"].map(repr)  # with every digit, as it was written
    identified.rewrite("identify/parameters.csv", table)
    identified.edit("runs/manifest.json", *[('"numpy": "', '"numpy":  "0.')] * 2)
    answer = identified.calflow("reproduce", identified / "runs", "--out", identified / "again")
    assert answer.code == 3
    assert "numpy 0." in answer.out
    assert "most in joint2.a: " in answer.out
    assert answer.out.splitlines()[-2].startswith("not the same")
    told = pd.read_csv(identified / "again" / "differences.csv")
    row = told[told["column"] == "estimate"].iloc[0]
    assert row["in_sd"] == pytest.approx(3, rel=1e-6)
    assert row["cells"] == 1
    assert (identified / "again" / "run" / "manifest.json").is_file()
    (said,) = identified.refused("reproduce", identified / "runs", "--out", identified / "again")
    assert said.startswith("again: is not empty")


def test_rounding_is_told_as_such(identified):
    """Fails if other last digits, as other versions make them, pass for another result."""
    table = pd.read_csv(identified / "runs" / "identify" / "parameters.csv", dtype=str, keep_default_na=False)
    table["estimate"] = (table["estimate"].astype(float) * (1 + 3e-9)).map("{:.10g}".format)
    identified.rewrite("identify/parameters.csv", table)
    answer = identified.calflow("reproduce", identified / "runs")
    assert answer.code == 3
    assert answer.out.splitlines()[-1].startswith("the same to 8 digits: no number differs by more than rounding")


def test_results_that_were_changed_are_not_compared(finished):
    """Fails if a table that somebody edited counts as what the run made."""
    finished.edit("runs/identify/accuracy.csv", ("mean", "main"))
    (told,) = finished.refused("reproduce", finished / "runs")
    assert told == "runs: identify/accuracy.csv was changed by hand since the run"


def test_a_run_that_does_not_say_what_it_was_made_of_is_refused(finished):
    """Fails if a run of an earlier version ends in a traceback."""
    finished.vouch(lambda manifest: manifest.pop("files"))
    for command in ("reproduce", "pack"):
        (told,) = finished.refused(command, finished / "runs")
        assert told.startswith("runs: an earlier version of calflow made this run")


def test_names_that_lead_above_the_study_keep_their_way():
    """Fails if files that were laid out again do not find each other."""
    places = laid_out(["study.toml", "../robots/r.toml", "../../data/m.csv", "../x/study.toml", "/far/away.csv"])
    assert places == {
        "study.toml": "above/above/study.toml", "../robots/r.toml": "above/robots/r.toml", "../../data/m.csv": "data/m.csv",
        "../x/study.toml": "above/x/study.toml",
    }  # fmt: skip


@pytest.fixture
def spread(small, tmp_path):
    """A study whose robot, candidates and confirming series lie in folders beside its own, and its run."""
    base = tmp_path / "spread"
    for name in ("robots", "first", "second"):
        (base / name).mkdir(parents=True)
    shutil.copy(small / "robot.toml", base / "robots" / "arm.toml")
    small.edit("study.toml", ('"robot.toml"', '"../robots/arm.toml"'))
    small.edit("quick.toml", ('["select", "identify", "sample"]', '["select", "identify", "diagnose"]'))
    small.edit("quick.toml", ("candidates = 100", 'candidates_file = "../robots/poses.csv"'))
    for name in ("first", "second"):
        for file in ("study.toml", "quick.toml", "measurements.csv"):
            shutil.copy(small / file, base / name / file)
    small.rows[[f"q{i}_deg" for i in (1, 2, 3)]].drop_duplicates().to_csv(base / "robots" / "poses.csv", index=False)
    folder = Folder(base / "first")
    folder.edit("study.toml", ("effects =", 'confirm = "../second/study.toml"\neffects ='))
    second = Folder(base / "second")
    second.measure(second.rows[::-1])
    answer = folder.calflow("run")
    assert answer.code == 0, answer
    return folder


def test_a_packed_run_is_repeated_elsewhere(spread, tmp_path, monkeypatch):
    """Fails if the archive lacks an input, or data of the same name on the other machine take the place of its own."""
    answer = spread.calflow("pack", spread / "runs", "--out", tmp_path / "run.zip")
    assert answer.code == 0, answer
    shutil.rmtree(tmp_path / "spread")
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        archive.extractall(tmp_path / "elsewhere")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "measurements.csv").write_text("other", encoding="utf-8")
    monkeypatch.setenv("CALFLOW_DATA", str(tmp_path / "data"))
    found = reproduce(tmp_path / "elsewhere")
    assert not found.other
    assert {"identify/parameters.csv", "diagnose/findings.csv", "select/poses.csv"} <= set(found.same)


def test_an_archive_has_the_same_bytes_each_time_and_describes_each_file(finished, tmp_path):
    """Fails if time or order of files shows in the archive, or a reader of RO-Crates misses one, or what its columns mean."""
    from rocrate.rocrate import ROCrate

    for name in ("a.zip", "b.zip"):
        assert finished.calflow("pack", finished / "runs", "--out", tmp_path / name).code == 0
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with zipfile.ZipFile(io.BytesIO((tmp_path / "a.zip").read_bytes())) as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path / "crate")
    crate = ROCrate(tmp_path / "crate")
    described = {entity.id for entity in crate.data_entities}
    assert described == names - {"ro-crate-metadata.json"}
    table = crate.dereference("identify/parameters.csv")
    assert table["subjectOf"].id == "datapackage.json"
    lock = (tmp_path / "crate" / "environment.txt").read_text(encoding="utf-8").splitlines()
    assert {"numpy", "casadi"} <= {line.partition("==")[0] for line in lock}
    assert not any(line.startswith("calflow") for line in lock)  # no index has it, or somebody else's
    assert any(line.startswith("# and calflow ") for line in lock)
    action = crate.dereference("#run")
    assert "inputs/files/measurements.csv" in {one.id for one in action["object"]}


@pytest.mark.parametrize(
    ("stated", "named", "name"),
    [
        ("cc-by-4.0", "https://spdx.org/licenses/CC-BY-4.0", "CC-BY-4.0"),
        ("MIT and CC0-1.0", "#licence", "MIT AND CC0-1.0"),
        ("LicenseRef-Ours", "#licence", "LicenseRef-Ours"),
    ],
)
def test_an_archive_says_who_may_use_it_and_whose_it_is(finished, tmp_path, stated, named, name):
    """Fails if a reader of RO-Crates does not find the licence or an author."""
    from rocrate.rocrate import ROCrate

    people = ["--author", "Ada Lovelace", "--author", "Ge Wang"]
    answer = finished.calflow("pack", finished / "runs", "--out", tmp_path / "run.zip", "--licence", stated, *people)
    assert (answer.code, answer.err) == (0, "")
    crate = ROCrate(tmp_path / "run.zip")
    assert (crate.license.id, crate.license["name"]) == (named, name)
    assert [one["name"] for one in crate.root_dataset["author"]] == ["Ada Lovelace", "Ge Wang"]


def test_a_licence_that_nobody_knows_is_refused(finished, tmp_path):
    """Fails if a misspelt licence goes into an archive, or one that states none is written without a word."""
    (told,) = finished.refused("pack", finished / "runs", "--out", tmp_path / "run.zip", "--licence", "CC-BY")
    assert told.startswith("--licence 'CC-BY' is no SPDX licence expression")
    assert not (tmp_path / "run.zip").exists()
    assert "no licence stated" in finished.calflow("pack", finished / "runs", "--out", tmp_path / "run.zip").err


def test_what_is_named_by_an_absolute_path_cannot_be_packed(finished):
    """Fails if an archive is made that no other machine can repeat."""
    finished.edit("study.toml", ('file = "measurements.csv"', f'file = "{finished / "measurements.csv"}"'))
    assert finished.calflow("run", "--stage", "identify", "--out", finished / "other").code == 0
    (told,) = finished.refused("pack", finished / "other")
    assert "is named by an absolute path" in told
    assert finished.calflow("reproduce", finished / "other").code == 0
