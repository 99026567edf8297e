"""The cache key: everything that a stage's results depend on, and nothing else."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import calflow
from calflow.runs.cache_key import common_key, stage_key
from calflow.stages.catalogue import STAGES
from calflow.study import load_study


def keys(folder):
    """Every stage's key."""
    study = load_study(folder.path)
    return {name: stage_key(study, stage, common_key(study), {}) for name, stage in STAGES.items()}


def differing(before, after):
    """By stage, the names of what changed."""
    return {
        stage: {name for name in {**before[stage], **after[stage]} if before[stage].get(name) != after[stage].get(name)}
        for stage in before
    }


def test_a_title_concerns_the_report_alone(small):
    """Fails if a new title fits, searches and samples again, or the report keeps the old one."""
    before = keys(small)
    small.edit("study.toml", ('name = "small"', 'name = "small"\ntitle = "Robot 17"'))
    found = differing(before, keys(small))
    assert found.pop("report") == {"study's title"}
    assert not any(found.values())


CHANGES = {
    "its study": ("study.toml", "holdout = 0.3", "holdout = 0.4", {"confirming study.toml"}),
    "its robot": ("robot.toml", "a_mm = 700", "a_mm = 701", {"confirming robot.toml"}),
    "its measurements": ("measurements.csv", "light", "heavy", {"confirming measurements.csv"}),
    "its title": ("study.toml", 'name = "small"', 'name = "small"\ntitle = "x"', set()),
    "its stages": ("study.toml", "poses = 8", "poses = 9", set()),
}


@pytest.mark.parametrize(("name", "old", "new", "expected"), CHANGES.values(), ids=CHANGES)
def test_the_confirming_study_counts_with_all_its_files(small, name, old, new, expected):
    """Fails if a confirmation by other data, or by another robot, is taken for this one's."""
    shutil.copytree(small.path, small / "second")
    small.edit("study.toml", ("seed = 7", 'seed = 7\nconfirm = "second"'))
    before = keys(small)
    small.edit(f"second/{name}", (old, new))
    assert differing(before, keys(small))["diagnose"] == expected
    before = keys(small)
    small.edit("measurements.csv", ("light", "heavy"))  # a file of the same name as the other series'
    assert differing(before, keys(small))["diagnose"] == {"file measurements.csv"}


INSTALLED = """
import sys
from pathlib import Path
import calflow
from calflow.runs.cache_key import code_digest
from calflow.study import workflow_folder

print(workflow_folder(), calflow.__file__, code_digest())
for name in sys.argv[1:]:
    path = Path(calflow.__file__).parent / name
    path.write_text(path.read_text(encoding="utf-8") + "\\n", encoding="utf-8")
    code_digest.cache_clear()
    print(code_digest())
"""


def test_an_installed_package_counts_as_a_whole(tmp_path):
    """Fails if a wheel, which holds the workflows too, cannot be hashed, or a change of any file in it goes unseen."""
    source = Path(calflow.__file__).parent
    package = tmp_path / "site" / "calflow"
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(source.parents[1] / "workflows", package / "_workflows")
    changed = ("_workflows/calibrate.toml", "reporting/template.typ", "runs/run.py")
    done = subprocess.run(
        [sys.executable, "-c", INSTALLED, *changed], capture_output=True, text=True, check=True, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "site")},
    )  # fmt: skip
    workflows, init, *digests = done.stdout.split()
    assert (workflows, init) == (str(package / "_workflows"), str(package / "__init__.py"))
    assert len(set(digests)) == 1 + len(changed)
