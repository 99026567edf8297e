"""JSON Schemas of the files: an editor's checker passes what calflow reads and refuses what it refuses, with the key's name."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from calflow.commands.file_schemas import SCHEMAS, schema
from conftest import in_process

ROOT = Path(__file__).parents[1]
TAPLO = shutil.which("taplo") or str(Path(sys.executable).parent / "taplo")
SHIPPED = {
    "study": [*ROOT.glob("studies/*/study*.toml"), *ROOT.glob("studies/first-steps/[stw]*.toml")],
    "robot": [*ROOT.glob("studies/*/robot*.toml"), *ROOT.glob("src/calflow/templates/robots/*.toml")],
    "urdf-robot": [ROOT / "studies" / "first-steps" / "arm.toml"],
    "truth": [*ROOT.glob("studies/*/truth*.toml")],
    "workflow": [*ROOT.glob("workflows/*.toml")],
}


@pytest.fixture(scope="session")
def schemas(tmp_path_factory):
    """The folder of all schemas."""
    folder = tmp_path_factory.mktemp("schemas")
    assert in_process("schema", "--out", folder).code == 0
    return folder


def checked(schemas: Path, kind: str, *paths: Path) -> subprocess.CompletedProcess[str]:
    """What Taplo says of files."""
    named = f"file://{schemas / kind}.schema.json"
    return subprocess.run([TAPLO, "check", "--schema", named, *map(str, paths)], capture_output=True, text=True)


@pytest.mark.parametrize("kind", SHIPPED)
def test_the_shipped_files_pass(schemas, kind):
    """Fails if an editor marks what calflow reads."""
    assert SHIPPED[kind]
    done = checked(schemas, kind, *SHIPPED[kind])
    assert done.returncode == 0, done.stderr


STUDY = 'name = "x"\nrobot = "robot.toml"\nseed = 1\n'
ROBOT = (ROOT / "src/calflow/templates/robots/ur10.toml").read_text(encoding="utf-8")
WRONG = [
    ("study", STUDY + "efects = []\n", "efects"),
    ("study", STUDY.replace("1", '"1"'), "integer"),
    ("study", STUDY.replace("seed = 1\n", ""), "seed"),
    ("study", STUDY + 'effects = ["geometrie"]\n', "geometrie"),
    ("study", STUDY + "[stages.select]\npose = 5\n", "pose"),
    ("study", STUDY + "[stages.select]\nposes = 2\n", "minimum"),
    ("study", STUDY + "[stages.selct]\n", "selct"),
    ("study", STUDY + '[measurements]\nfile = "m.csv"\nsigma = 1\n', "sigma"),
    ("study", STUDY + '[measurements]\nfile = "m.csv"\nsigma_mm = -1\n', "sigma_mm"),
    ("study", STUDY + "[parameters.joint3.theta]\nfixd = true\n", "fixd"),
    ("study", STUDY + "[parameters.joint3.theta]\nfixed = 1\n", "boolean"),
    ("study", STUDY + '[parameters.joint3.theta]\nlower_mrad = "-1"\n', "number"),
    ("study", STUDY + "[parameters.joint3.theta]\nprior_mean_deg = 0\nprior_sd_deg = 0\n", "minimum"),
    ("robot", ROBOT.replace("d_mm", "d_cm", 1), "d_cm"),
    ("robot", ROBOT.replace("[-360, 360]", "[-360]", 1), "items"),
    ("robot", ROBOT.replace('convention = "', 'convention = "x', 1), "convention"),
]


@pytest.mark.parametrize(("kind", "text", "told"), WRONG)
def test_a_wrong_key_or_type_is_marked(schemas, tmp_path, kind, text, told):
    """Fails if an editor lets pass what calflow refuses, or does not name it."""
    study, robot = (text, ROBOT) if kind == "study" else (STUDY, text)
    (tmp_path / "study.toml").write_text(study, encoding="utf-8")
    (tmp_path / "robot.toml").write_text(robot, encoding="utf-8")
    done = checked(schemas, kind, tmp_path / f"{kind}.toml")
    assert done.returncode == 1
    assert told in done.stderr
    answer = in_process("check", tmp_path)
    assert answer.code == 2
    assert f"{kind}.toml" in answer.err


SEVERAL = """
[[measurements]]
file = "a.csv"
[[measurements]]
file = "b.csv"
kind = "distance"
settings = { offset_mm = 1 }
"""
STATED = """
[parameters]
joint1.d = { fixed = true }
"joint2.joint-error-map[harmonics 3].cos1" = { lower_urad = -50 }
[parameters.joint3.theta]
fixed = true
value_deg = 0.1
[parameters.joint3.joint-compliance]
c = { prior_mean_rad_per_Nm = 1e-7, prior_sd_rad_per_Nm = 1e-8, upper_rad_per_Nm = 1e-6 }
"""
RIGHT = [
    ("study", STUDY + STATED),
    ("study", STUDY + "[acceptance]\ndate = 2025-11-20\ntolerance_um = 200\n"),
    ("study", STUDY + SEVERAL),
    ("robot", ROBOT + '\n[payloads.load]\nmass_kg = "unknown"\n'),
    ("robot", ROBOT + "\n[payloads.load]\nmass_g = 5\n"),
    (
        "fleet",
        '[fleet]\nname = "p"\n[types.a]\nstudy = "s.toml"\ndata = "{robot}.csv"\n'
        '[robots.r1]\ntype = "a"\ndata = ["x.csv"]\n',
    ),
    ("frames", "[frames.bench]\norigin_mm = [1, 2, 3]\n"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "text"), RIGHT)
def test_rarer_keys_pass(schemas, tmp_path, kind, text):
    """Fails if a date, several series, an unknown mass or another unit is marked."""
    path = tmp_path / "file.toml"
    path.write_text(text, encoding="utf-8")
    done = checked(schemas, kind, path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("robot", ["", "ur10e"])
def test_a_new_study_names_its_schemas(tmp_path, robot):
    """Fails if an editor does not find the schema that a new file's first line names, or the file does not pass."""
    assert in_process("new", tmp_path / "mine", *(["--robot", robot] if robot else [])).code == 0
    for name in ("study.toml", "robot.toml", "truth.toml"):
        first = (tmp_path / "mine" / name).read_text(encoding="utf-8").splitlines()[0]
        assert first.startswith("#:schema ")
        assert (tmp_path / "mine" / first.removeprefix("#:schema ")).is_file()
    done = subprocess.run([TAPLO, "check"], capture_output=True, text=True, cwd=tmp_path / "mine")
    assert done.returncode == 0, done.stderr
    (tmp_path / "mine" / "study.toml").write_text("#:schema .schemas/study.schema.json\nname = 1\n", encoding="utf-8")
    assert subprocess.run([TAPLO, "check"], capture_output=True, cwd=tmp_path / "mine").returncode == 1


@pytest.mark.parametrize("kind", SCHEMAS)
def test_bounds_and_defaults_are_in_the_unit_of_their_key(kind):
    """Fails if a schema is no JSON, or tells a default of SI beside a key in mm."""
    assert json.dumps(schema(kind))
    assert schema(kind, "2020-12")["$schema"].endswith("2020-12/schema")
    select = schema("study", "2020-12")["$defs"]["SelectSettings"]["properties"]
    assert select["drift_mm"]["default"] == 0.05
    assert select["drift_um"]["default"] == 50


def test_the_keys_of_a_stated_parameter_are_completed():
    """Fails if an editor does not offer a key of a parameter in a unit that a file may use, or says nothing of it."""
    offered = schema("study", "2020-12")["$defs"]["ParameterTable"]["properties"]
    assert {"fixed", "value_deg", "lower_mm", "upper_mrad", "prior_mean_um", "prior_sd_rad_per_Nm"} <= set(offered)
    assert all(key["description"] for key in offered.values())


def test_an_unknown_kind_is_told():
    """Fails if a misspelt kind ends in a traceback."""
    answer = in_process("schema", "stdy")
    assert (answer.code, answer.err) == (
        2, "unknown kind 'stdy'; there are study, robot, urdf-robot, workflow, truth, frames, fleet, did you mean 'study'?\n",
    )  # fmt: skip
    assert in_process("schema").code == 2
