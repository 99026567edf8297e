"""The tutorial and the pages of tasks, word for word: their files are written, their commands and their Python run."""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import takewhile
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from click import Command, Group

from calflow.cli import cli
from calflow.measurements.source import LARGEST, LONGEST
from conftest import in_process
from made.walk import blocks, ended_well, follow, pictures
from reporting.page_one import of_run, unreadable

DOCS = Path(__file__).parents[1] / "docs"
PAGES = (  # in the order in which a newcomer reads them
    *("tutorial", "robots", "import", "board_poses", "select", "next", "identify", "diagnose", "sample"),
    *("compensate", "programs", "export", "ros", "validate", "drift", "compare", "reproduce", "residual_field"),
)
EVERY = sorted([*DOCS.rglob("*.md"), *DOCS.parent.glob("*.md"), *DOCS.parent.joinpath("benchmarks").rglob("*.md")])
DATA = os.environ.get("CALFLOW_DATA")


def run(line: str) -> str:
    """Run a line of a shell block; what it printed."""
    program, command, *arguments = shlex.split(line)
    assert program == "calflow"
    answer = in_process(command, *arguments)
    assert ended_well(line, answer.code), f"{line}\n{answer.out}{answer.err}"
    return answer.out + answer.err


def page_text(name: str) -> str:
    """The Markdown of a page."""
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def test_a_quotation_is_held_against_what_was_printed(tmp_path, monkeypatch):
    """Fails if a page's answer may differ from what is printed. Building the site follows the pages with pictures by this."""
    monkeypatch.chdir(tmp_path)
    page = (
        "Into `a/b.toml`:\n\n```toml\nx = 1\n```\n\n```sh\ncalflow check a\n```\n\n```text\nnominal  …  4.9\nok\n```\n"
    )
    assert follow(page, lambda _: "3 rows\n  nominal 1.9 4.9\nok") == {
        "calflow check a": "3 rows\n  nominal 1.9 4.9\nok"
    }
    assert Path("a/b.toml").read_text(encoding="utf-8") == "x = 1\n"
    for printed in ("nominal 1.9 5.0\nok", "ok\nnominal 1.9 4.9", ""):
        with pytest.raises(AssertionError, match="the page quotes"):
            follow(page, lambda _, printed=printed: printed)
    assert ended_well("calflow drift runs/a b.csv", 3)
    assert not ended_well("calflow check a", 2)
    assert pictures("text\n![one](shown/runs/a/report.pdf.1.png)\n![other](own.svg)\n") == ["runs/a/report.pdf.1.png"]


def test_every_message_that_is_explained_can_come():
    """Fails if the page on messages explains one that the code does not say: its words are between what differs, `…`."""
    code = "\n".join(path.read_text(encoding="utf-8") for path in (DOCS.parent / "src").rglob("*.py"))
    said = re.sub(r"""["']\s*\n\s*f?["']""", "", code).replace("\\", "")
    explained = re.findall(r"^\| (?:[^|`*]*)[`*]([^`*]+)[`*]", page_text("troubleshooting"), re.MULTILINE)
    fragments = {part.strip(" ;:(") for message in explained for part in message.split("…")}
    assert len(fragments) > 30
    assert not sorted(part for part in fragments if part not in said)


@pytest.mark.parametrize("page", EVERY, ids=lambda page: page.stem)
def test_every_command_is_one(page):
    """Fails if a page calls a command that calflow does not have, or one with an option that it does not know."""
    text = page.read_text(encoding="utf-8")
    lines = [line for block in blocks(text) if block.kind in ("sh", "bash") for line in block.text.splitlines()]
    lines += re.findall(r"^    (calflow .*)$", text, re.MULTILINE) + re.findall(r"`(calflow [a-z][^`\n]*)`", text)
    for line in (line.removeprefix("calflow ") for line in lines if line.startswith("calflow ")):
        words = list(takewhile(lambda word: word != "--", shlex.split(line, comments=True)))
        command: Command = cli
        while words and isinstance(command, Group):
            command = command.commands[words.pop(0)]
        known = {option for parameter in command.params for option in parameter.opts}
        unknown = {word for word in words if word.startswith("--")} - known - {"--help"}
        assert not unknown, f"calflow {line}: {unknown}"


def test_what_the_pages_promise_comes_true(tmp_path, monkeypatch):
    """Fails if a block of the pages does not run one after the other, or what it leads to is not what the text promises."""
    if DATA is None or not Path(DATA, "fanuc-r2000").is_dir():
        pytest.skip("CALFLOW_DATA names no folder with fanuc-r2000, the tutorial's measurements")
    monkeypatch.chdir(tmp_path)
    said = dict[str, str]()
    for page in PAGES:
        with shorter_run(tmp_path) if page == "reproduce" else nullcontext():
            said |= follow(page_text(page).replace("candidates = 500", "candidates = 150"), run)  # sooner chosen
    commands_land(tmp_path, said)
    page_one_is_read_at_a_glance(tmp_path)
    poses_could_be_little_better(tmp_path)
    tasks_write_what_they_say(tmp_path)
    what_is_not_physical_is_called_so(tmp_path, said)
    ros_reads_the_same_robot(tmp_path)


@contextmanager
def shorter_run(folder: Path) -> Iterator[None]:
    """Have the page's run stop at geometry: to repeat a diagnosis takes as long as all that the tutorial asks for."""
    runs = folder / "runs"
    shutil.move(runs / "my-robot", folder / "whole")
    shutil.copytree(runs / "geometry", runs / "my-robot")
    yield
    shutil.rmtree(runs / "my-robot")
    shutil.move(folder / "whole", runs / "my-robot")


def commands_land(folder: Path, said: dict[str, str]) -> None:
    """The tutorial's run ends with a report, and with commands for every target."""
    assert "the nominal robot's error" in said["calflow check my-robot"]
    assert {"report.pdf", "report.html"} <= {path.name for path in (folder / "runs/my-robot").iterdir()}
    assert list((folder / "runs/my-robot/figures").iterdir())
    commands = pd.read_csv(folder / "commands.csv", sep=";")  # as the targets are
    assert len(commands)
    assert commands["reached"].all()
    before, after = (
        (folder / name).read_text(encoding="utf-8").splitlines() for name in ("weld.ls", "weld.corrected.ls")
    )
    changed = [old for old, new in zip(before, after, strict=True) if old != new]
    assert changed
    assert all("J1=" in line or "J4=" in line for line in changed)


def page_one_is_read_at_a_glance(folder: Path) -> None:
    """Page one of the tutorial's report has no jargon, and names no cause beside itself."""
    stages = ("identify", "diagnose", "residual_field")
    page_one = of_run(folder / "my-robot/study.toml", folder / "runs/my-robot", *stages)
    assert unreadable(page_one) == []
    assert not any(re.search(r"sag of the tool (from|or) sag of the tool", text) for text in page_one)


def poses_could_be_little_better(folder: Path) -> None:
    """The plan has the files that the page names, and other poses could be better by no more than it says."""
    for name in ("poses.csv", "observability.csv"):
        assert len(pd.read_csv(folder / "plan/select" / name)), name
    certificate = json.loads((folder / "plan/select/certificate.json").read_text(encoding="utf-8"))
    assert certificate["criterion"] == "tool"
    assert 0 <= certificate["could_gain_percent"] < 5
    number = json.loads((folder / "plan/select/how_many.json").read_text(encoding="utf-8"))
    assert 0 < number["needed_poses"] <= number["enough_poses"] < 100


def tasks_write_what_they_say(folder: Path) -> None:
    """Next, validate, drift and compare leave the files that their pages name."""
    for name in (
        "first/poses.csv",
        "next/verdict.json",
        "accepted/report.pdf",
        "check/moved.csv",
        "check/recalibration.csv",
        "check/next_poses.csv",
    ):
        assert (folder / name).is_file(), name
    assert (folder / "compared/report.pdf").is_file()
    assert (folder / "my-robot.zip").is_file()


def ros_reads_the_same_robot(folder: Path) -> None:
    """The xacro with calibrated origins has its tool where the exported URDF has it, and the launch files are Python."""
    properties = dict(
        re.findall(r'name="(\w+)" value="([^"]*)"', (folder / "calibrated.xacro").read_text(encoding="utf-8"))
    )
    written = (folder / "my_arm.urdf.xacro").read_text(encoding="utf-8")
    own = pin.buildModelFromXML(re.sub(r"\$\{(\w+)\}", lambda name: properties[name[1]], written))
    whole = pin.buildModelFromUrdf(str(folder / "my_arm.urdf"))
    reading = np.radians([10, 20, -30, 40, 50, -60])
    places = []
    for model in (own, whole):
        data = model.createData()
        pin.framesForwardKinematics(model, data, reading)
        places.append(data.oMf[model.getFrameId("tool0")].homogeneous)
    assert np.allclose(*places, atol=1e-9)
    for name in ("show_arm.launch.py", "my_arm.launch.py"):
        ast.parse((folder / name).read_text(encoding="utf-8"))


def what_is_not_physical_is_called_so(folder: Path, said: dict[str, str]) -> None:
    """The page's study asks for a residual field, and none is used on so few poses that gain nothing by it."""
    assert "residual field (not physical) not applied" in said["calflow run my-robot --stage residual_field"]
    assert "not_physical_x_mm" not in pd.read_csv(folder / "predicted.csv", sep=None, engine="python")


def test_the_page_on_security_names_what_the_code_does():
    """Fails if an environment variable, a limit of fetching, or what is started beside calflow, is not on the page that says so."""
    said = (DOCS / "security.md").read_text(encoding="utf-8")
    code = {path: path.read_text(encoding="utf-8") for path in (DOCS.parent / "src").rglob("*.py")}
    variables = {name for text in code.values() for name in re.findall(r'os\.environ\S*[\[(]"(\w+)"', text)}
    assert variables == {"CALFLOW_DATA", "CC", "XDG_CACHE_HOME", "TMPDIR", "OMP_NUM_THREADS"}
    assert not [name for name in variables if f"`{name}`" not in said]
    assert f"{LARGEST / 1e6:.0f} MB and {LONGEST / 60:.0f} minutes" in said
    starting = {
        path.stem for path, text in code.items() if "import subprocess" in text or "from multiprocessing import" in text
    }
    assert starting == {"model", "engine"}  # the compiler, and Snakemake
    sending = {
        path.stem
        for path, text in code.items()
        if re.search(r"^from (urllib\.(?!parse)|http|socket)|^import (socket|requests)", text, re.M)
    }
    assert sending == {"source"}


@pytest.mark.parametrize("page", EVERY, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    """Fails if a page links to a file, or to a heading of one, that is not there, or a page of the site to one outside of it."""
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target or target in (f"shown/{path}" for path in pictures(text)):
            continue
        target = target.replace("first_calibration.md", "first_calibration.ipynb")  # of which the site makes a page
        name, _, anchor = target.partition("#")
        path = page.parent / name if name else page
        assert path.exists(), target
        assert DOCS not in page.parents or path.resolve().is_relative_to(DOCS), f"{target} is not in the site"
        if anchor:
            headings = re.findall(r'^(?: *")?#+ (.*?)(?:\\n",)?$', path.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}, (
                target
            )
