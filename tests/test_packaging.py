"""Packaging: the conda recipe and the container file say what pyproject.toml says, as far as that shows without either program."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONTAINER = (ROOT / ".ci" / "Containerfile").read_text(encoding="utf-8")
OF_CONDA = {"matplotlib": "matplotlib-base", "typst": "typst-py"}  # what conda-forge calls them


@pytest.fixture(scope="module")
def recipe():
    """The conda recipe."""
    return yaml.safe_load((ROOT / ".ci" / "conda" / "meta.yaml").read_text(encoding="utf-8"))


def test_the_recipe_needs_what_the_project_needs(recipe):
    """Fails if a dependency, its least version or Python's was changed at one of the two places alone."""
    needs = [Requirement(text) for text in PROJECT["project"]["dependencies"]]
    own = {f"{OF_CONDA.get(need.name, need.name)} {need.specifier}" for need in needs}
    assert set(recipe["requirements"]["run"]) == own | {f"python {PROJECT['project']['requires-python']}"}
    (build,) = (Requirement(text) for text in PROJECT["build-system"]["requires"])
    assert f"{build.name} {build.specifier}" in recipe["requirements"]["host"]


def test_the_recipe_is_of_this_project(recipe):
    """Fails if its version, licence, command or sources are others."""
    own = PROJECT["project"]
    assert recipe["package"] == {"name": own["name"], "version": own["version"]}
    assert (recipe["about"]["license"], recipe["about"]["summary"]) == (own["license"], own["description"])
    assert recipe["about"]["license_file"] in own["license-files"]
    assert recipe["build"]["entry_points"] == [f"{name} = {where}" for name, where in own["scripts"].items()]
    assert (ROOT / ".ci" / "conda" / recipe["source"]["path"] / "pyproject.toml").is_file()


def test_all_files_tell_of_one_version_and_one_licence():
    """Fails if the version, the licence or the authors were changed at one place alone, or a version has no release notes."""
    own = PROJECT["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["title"], citation["version"], citation["license"]) == (
        own["name"],
        own["version"],
        own["license"],
    )
    assert citation["authors"] == own["authors"]
    notes = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert notes[0] == own["version"]
    licence = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert licence.startswith(f"{own['license']} License")
    assert own["authors"][0]["name"] in licence


def test_the_container_is_built_of_what_is_there():
    """Fails if the file copies what the sources do not have, lacks what the wheel is made of, or starts something else."""
    lines = re.sub(r"\\\n", " ", CONTAINER).splitlines()
    steps = [line.partition(" ") for line in lines if line and not line.startswith("#")]
    copied = [shlex.split(rest)[:-1] for step, _, rest in steps if step == "COPY" and not rest.startswith("--from")]
    names = {name for own in copied for name in own}
    assert all((ROOT / name).exists() for name in names)
    target = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {
        *(path.split("/")[0] for path in target["packages"]),
        *target["force-include"],
        PROJECT["project"]["readme"],
        *PROJECT["project"]["license-files"],
    }
    assert needed | {"pyproject.toml"} <= names
    assert {step for step, _, _ in steps} <= {"ARG", "FROM", "WORKDIR", "COPY", "RUN", "ENV", "ENTRYPOINT", "CMD"}
    assert [rest for step, _, rest in steps if step == "ENTRYPOINT"] == [
        f'["{next(iter(PROJECT["project"]["scripts"]))}"]'
    ]


def test_the_shipped_wheel_is_tried():
    """Fails if what decides no longer builds the wheel and runs it."""
    assert "bash .ci/wheel" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    tried = (ROOT / ".ci" / "wheel").read_text(encoding="utf-8")
    assert all(word in tried for word in ("-m build", ".ci/distributions.py", "--version", "run tiny"))
