"""Forged manifests: whatever a stranger's says, a command ends in words, and an archive holds nothing that pip would obey."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator
from typing import Any

import pytest

COMMANDS = {"pack": ("--out", "run.zip"), "reproduce": (), "status": (), "predict": ("measurements.csv",)}


def asked(folder, command: str) -> list[object]:
    """A command on the run."""
    return [command, folder / "runs", *(folder / one if "." in one else one for one in COMMANDS[command])]


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The place of every value of a document, one of each dictionary with names of its own."""
    for key in list(value)[: 2 if at else None] if isinstance(value, dict) else ():
        yield (*at, key)
        yield from places(value[key], (*at, key))


def at(document: Any, place: tuple[Any, ...]) -> Any:
    """What is at a place."""
    for key in place:
        document = document[key]
    return document


@pytest.mark.parametrize("command", COMMANDS)
def test_a_manifest_with_a_zero_or_without_a_key_ends_in_words(finished, command):
    """Fails if a value that ends a name for the system, or that is not there, ends in a traceback."""
    path = finished / "runs" / "manifest.json"
    whole = path.read_text(encoding="utf-8")
    manifest = json.loads(whole)
    manifest.pop("sha256")
    for place in places(manifest):
        for spoilt in ("zero",) if command == "reproduce" else ("zero", "gone"):  # else the run is done again each time
            forged = json.loads(json.dumps(manifest))
            around, key = at(forged, place[:-1]), place[-1]
            value = around.pop(key)
            if spoilt == "zero":
                around.update({f"{key}\0": value} if isinstance(value, dict) else {key: f"{value}\0"})
            path.write_text(json.dumps(forged), encoding="utf-8")
            answer = finished.calflow(*asked(finished, command))
            assert "Traceback" not in answer.err, (place, spoilt)
            assert answer.code in ((2,) if spoilt == "zero" else (0, 1, 2)), (place, spoilt, answer)


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("numpy", "1.0\n--index-url https://a.b"),
        ("numpy", "1.0 --hash=x"),
        ("numpy", "1.0\n"),
        ("-r /etc/passwd\n#", "1.0"),
        ("x @ https://a.b/x.whl ; y", "1.0"),
        ("numpy", ""),
    ],
)
def test_what_is_no_version_is_not_packed(finished, name, version):
    """Fails if a line of environment.txt says to pip what is not a version."""
    finished.vouch(lambda manifest: manifest["environment"].update({name: version}))
    (told,) = finished.refused(*asked(finished, "pack"))
    assert "expected the version of a package, found" in told
    assert not (finished / "run.zip").exists()


@pytest.mark.parametrize("key", ["machine", "calflow", "code", "python"])
def test_a_remark_stays_one(finished, key):
    """Fails if a text that is packed as a remark goes on in a line of its own."""
    evil = "x\n--index-url https://a.b"
    finished.vouch(lambda manifest: (manifest["versions"] if key == "python" else manifest).update({key: evil}))
    assert finished.calflow(*asked(finished, "pack")).code == 0
    with zipfile.ZipFile(finished / "run.zip") as archive:
        lines = archive.read("environment.txt").decode().splitlines()
    assert all("index-url" not in line or line.startswith("#") for line in lines)


@pytest.mark.parametrize("command", ["pack", "reproduce"])
@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("", "is no file's name"), (".", "is no file's name"), ("..", "is no file's name"), ("a/..", "is no file's name"),
        ("/", "is no file's name"), ("other/study.toml", "do not have the study"), ("/study.toml", "do not have the study"),
        (None, "do not have the study"),
    ],
)  # fmt: skip
def test_a_study_that_is_not_where_it_should_be_is_refused(finished, command, name, told):
    """Fails if a run's study is listed nowhere, or as something that no file is called."""

    def renamed(manifest: dict[str, Any]) -> None:
        study = manifest["files"].pop("study.toml")
        manifest["files"] |= {} if name is None else {name: study}

    finished.vouch(renamed)
    (said,) = finished.refused(*asked(finished, command))
    assert told in said


def test_a_name_too_long_is_a_missing_file(finished):
    """Fails if a path that no system holds is trouble of the machine."""
    finished.vouch(lambda manifest: manifest["files"]["robot.toml"].update(path="/" + "x" * 5000, sha256="0"))
    assert "is missing" in finished.refused(*asked(finished, "pack"))[0]
