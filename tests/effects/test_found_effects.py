"""Effects of other packages: found by their entry points, and then like any other; what cannot be used is refused."""

from __future__ import annotations

import json
import os
import shutil
from importlib import metadata
from pathlib import Path

import pandas as pd
import pytest

from calflow.effects import catalogue
from calflow.estimation.model_tables import ModelEffect, read_effects
from calflow.files.problems import InputError
from calflow.robot.robot import Robot
from conftest import Folder, without_data
from plugin import HOSES, hoses, install

SOURCE = """\
import sys
from calflow.reporting import document
from calflow.reporting.section import sections
from calflow.runs.run import run
from calflow.stages.report import report_material
from calflow.study import load_study

study = load_study(".")
made = run(study, "runs")
material = report_material(study, made.results, made.folder)
sys.stdout.buffer.write(
    document.source("", [(s.title, s.write(material)) for s in sections() if s.applies(material)]).encode()
)
"""
NAME = "joint1.hose-pull[slack 0.2].pull"


class Shop:
    """A study's folder, and calflow in a process of its own in which the package of hoses is installed."""

    def __init__(self, folder, site: Path) -> None:
        self.folder = folder
        self.site = site

    def apart(self, *arguments: object) -> str:
        """Run python; what it printed."""
        path = os.pathsep.join(filter(None, (str(self.site), os.environ.get("PYTHONPATH"))))
        done = self.folder.forked(*arguments, env={**os.environ, "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"})
        assert done.returncode == 0, done.stderr
        return done.stdout

    def run(self, *options: object) -> str:
        """Run the study."""
        return self.apart("-m", "calflow", "run", ".", "--out", "runs", *options)

    def table(self, name: str) -> pd.DataFrame:
        """A table of the run."""
        return pd.read_csv(self.folder / "runs" / name)


@pytest.fixture(scope="module")
def _pulled(_measured, tmp_path_factory):
    small = Folder(tmp_path_factory.mktemp("shop") / "study")
    shutil.copytree(_measured.path, small.path)
    small.edit(
        "truth.toml",
        ('"joint-compliance"]', '"joint-compliance", "hose-pull"]'),
        ("[values.joint2]", "[values.joint1]\npull_mrad = 1.5\n\n[values.joint2]"),
    )
    small.edit("quick.toml", ('["select", "identify", "sample"]', '["identify", "diagnose", "report"]'))
    small.edit("quick.toml", ("[settings.sample]\nmax_steps = 60\nblock = 20\ness = 100\n", ""))
    small.edit("quick.toml", ("[settings.select]\ncandidates = 100\n", ""))
    small.edit("study.toml", ("[stages.select]\nposes = 8\n", ""))
    shop = Shop(small, hoses(tmp_path_factory.mktemp("site")))
    with without_data():
        shop.apart("-m", "calflow", "simulate", "truth.toml", "--force")
    return small


@pytest.fixture
def shop(_pulled, tmp_path, monkeypatch):
    """Data of a robot whose hoses pull, and a study that knows nothing of it."""
    monkeypatch.delenv("CALFLOW_DATA", raising=False)
    return Shop(_pulled.copied(tmp_path / "shop"), hoses(tmp_path / "site"))


def test_a_found_effect_is_named_added_and_told(shop):
    """Fails if another package's effect is not looked for, or its words, units, variant or name stay behind on the way."""
    shop.run()
    (found,) = shop.table("diagnose/findings.csv").to_dict("records")
    assert (found["status"], found["cause"], found["joint"]) == ("named", "hose-pull", 1)
    assert abs(found["estimate"] - 1.5e-3) < 4 * found["sd"]
    own = shop.table("diagnose/parameters.csv").set_index("parameter").loc[NAME]
    assert list(own[["effect", "variant", "part", "symbol"]]) == ["hose-pull", "slack 0.2", "joint1", "pull"]
    assert NAME in shop.table("diagnose/covariance.csv")
    assert json.loads(shop.table("diagnose/effects.csv")["variant"].iloc[-1]) == {"slack": 0.2}

    text = shop.apart("-c", SOURCE)  # reads the extended model back, and writes the report of it
    assert "1. Hose pull of column 1 (slack of 0.2 rad²)" in text
    assert "Stretched hoses turn the column: turn at full stretch" in text
    assert "thousandths" in text
    assert "hose pull slack 0.2" in text  # its heading among the parameters


def test_a_study_may_have_a_found_effect_from_the_start(shop):
    """Fails if a study cannot ask for it, the run forgets whose it was, or an edit of the package changes nothing."""
    shop.folder.edit("study.toml", ('"joint-compliance"]', '"joint-compliance", "hose-pull"]'))
    shop.run("--stage", "identify")
    own = shop.table("identify/parameters.csv").set_index("parameter").loc[NAME]
    assert abs(own["estimate"] - 1.5e-3) < 4 * own["sd"]

    manifest = json.loads((shop.folder / "runs" / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["packages"]["calflow_hoses"].startswith("1.2 ")
    plan = "-m", "calflow", "plan", ".", "--out", "runs", "--stage", "identify"
    module = shop.site / "calflow_hoses.py"
    module.write_text(HOSES + "# another line\n", encoding="utf-8")
    assert "package calflow_hoses changed" in shop.apart(*plan)
    module.write_text(HOSES, encoding="utf-8")
    assert "reuse" in shop.apart(*plan)
    shutil.rmtree(shop.site / "calflow_hoses-1.2.dist-info")
    install(shop.site, "calflow_hoses", HOSES, "hose-pull = calflow_hoses:HosePull", version="1.3")
    assert "package calflow_hoses changed" in shop.apart(*plan)

    shutil.rmtree(shop.site)
    answer = shop.folder.calflow("plan")
    assert answer.code == 2
    assert "unknown effect 'hose-pull'" in answer.err


TOY = """\
from calflow.effects import Effect
from calflow.robot.parts import Parameter


class Toy(Effect):
    id = "{id}"
    title = "a toy"
    {more}

    def parameters(self):
        return (Parameter(self.id, "toy", "p", "m", 1.0, -1.0, 1.0),)


class Half(Effect):
    id = "half"
    title = "half an effect"
"""
REFUSED = {
    "clash": ("joint-backlash", "", "{m}:Toy", ["its id is taken by calflow itself"]),
    "no effect": ("toy", "", "{m}:Parameter", ["no subclass of calflow.effects.base.Effect"]),
    "no class": ("toy", "", "{m}", ["no subclass of calflow.effects.base.Effect"]),
    "abstract": ("half", "", "{m}:Half", ["lacks parameters"]),
    "not there": ("toy", "", "{m}:Gone", ["cannot be imported", "Gone"]),
    "broken": ("toy", "boom = 1 / 0", "{m}:Toy", ["cannot be imported", "ZeroDivisionError"]),
    "another name": ("other", "", "{m}:Toy", ["calls itself 'toy'"]),
    "unknown need": ("toy", 'needs = ("humidity", "masse")', "{m}:Toy", ["'humidity' and 'masse', did you mean 'masses'?"]),
    "plain names": ("toy", 'tag = ""', "{m}:Toy", ["its parameters' names are not its own"]),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_used_is_refused_by_name(case, tmp_path, monkeypatch):
    """Fails if a mistake in another package goes unsaid, is a traceback, or does not tell which package made it."""
    name, more, value, said = REFUSED[case]
    module = f"broken_{case.replace(' ', '_')}"
    own = "joint-backlash" if case == "clash" else "toy"
    source = TOY.format(id=own, more=more or "size = 1")
    monkeypatch.syspath_prepend(install(tmp_path, module, source, f"{name} = {value.format(m=module)}"))
    with pytest.raises(InputError) as refused:
        catalogue.__wrapped__()
    (problem,) = refused.value.problems
    for words in (f"package '{module}'", f"'{name}'", *said):
        assert words in problem.message


def test_two_packages_may_not_bring_the_same_id_and_all_mistakes_are_told_at_once(tmp_path, monkeypatch):
    """Fails if one package silently takes the place of another, or the user mends one mistake a time."""
    for module in ("one_toy", "two_toys"):
        install(tmp_path, module, TOY.format(id="toy", more="size = 1"), f"toy = {module}:Toy\nhalf = {module}:Half")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError) as refused:
        catalogue.__wrapped__()
    said = [problem.message for problem in refused.value.problems]
    assert len(said) == 3
    assert any("package 'two_toys' brings 'toy'" in text and "taken by package 'one_toy'" in text for text in said)


def test_a_mistake_of_another_package_ends_a_command_without_a_traceback(small, tmp_path):
    """Fails if the user sees a traceback, or another exit code than that of refused input."""
    site = install(tmp_path / "site", "bad_toy", TOY.format(id="toy", more="boom = 1 / 0"), "toy = bad_toy:Toy")
    path = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))
    answer = small.forked("-m", "calflow", "check", ".", env={**os.environ, "PYTHONPATH": path})
    assert answer.returncode == 2
    assert "package 'bad_toy'" in answer.stderr
    assert "Traceback" not in answer.stderr


def test_a_run_with_an_effect_that_is_gone_is_refused(small):
    """Fails if a run whose package was removed ends in a traceback, or reads back as another model."""
    row = ModelEffect(effect="hose-pull", part="joint1", variant='{"slack": 0.2}')
    with pytest.raises(InputError, match=r"'hose-pull'.*install the package"):
        read_effects([row], Robot.from_toml(small / "robot.toml"))


def test_nothing_else_is_installed_here():
    """Fails if the catalogue that the other tests see holds what is not calflow's."""
    assert not metadata.entry_points(group="calflow.effects")
    assert all(kind.__module__.startswith("calflow.effects.") for kind in catalogue().values())
