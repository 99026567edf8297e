"""The tutorial and the pages of tasks, word for word: their files are written, their commands and their Python run."""

from __future__ import annotations

import json
import os
import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

from calflow.measurements.source import LARGEST, LONGEST
from conftest import in_process

DOCS = Path(__file__).parents[1] / "docs"
PAGES = (  # in the order in which a newcomer reads them
    *("tutorial", "robots", "import", "select", "next", "identify", "diagnose", "sample"),
    *("compensate", "programs", "export", "validate", "drift", "compare", "reproduce", "residual_field"),
)
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
VERDICTS = {"validate": (0, 3, 4), "drift": (0, 3, 4), "next": (0, 4)}  # exit codes that are answers
DATA = os.environ.get("CALFLOW_DATA")


def write(block: str, before: str) -> None:
    """Write a block into the file that the text before it names; in the place of the table that it names, if it does."""
    named = re.findall(r"`([^`\n]+)`", before)
    path = Path([name for name in named if re.fullmatch(r"[\w/-]+\.\w+", name)][-1])
    if named[-1].startswith("["):
        head, table, _ = path.read_text(encoding="utf-8").partition(named[-1])
        assert table, f"{path} has no {named[-1]}"
        block = head + block
    path.write_text(block, encoding="utf-8")


def run(line: str) -> str:
    """Run a line of a shell block; what it printed."""
    program, command, *arguments = shlex.split(line)
    assert program == "calflow"
    answer = in_process(command, *arguments)
    assert answer.code in VERDICTS.get(command, (0,)), f"{line}\n{answer.out}{answer.err}"
    return answer.out + answer.err


def follow(page: str) -> dict[str, str]:
    """Do all that a page says in the working folder; what was printed at each line."""
    said: dict[str, str] = {}
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    for found in BLOCK.finditer(text):
        kind, block = found.groups()
        if kind == "sh":
            said |= {line: run(line) for line in block.splitlines()}
        elif kind == "python":
            exec(compile(block, page, "exec"), {})
        elif kind != "text":  # what a command answered
            write(block, text[: found.start()])
    return said


def test_what_the_pages_promise_comes_true(tmp_path, monkeypatch):
    """Fails if a block of the pages does not run one after the other, or what it leads to is not what the text promises."""
    if DATA is None or not Path(DATA, "fanuc-r2000").is_dir():
        pytest.skip("CALFLOW_DATA names no folder with fanuc-r2000, the tutorial's measurements")
    monkeypatch.chdir(tmp_path)
    said = dict[str, str]()
    for page in PAGES:
        said |= follow(page)
    commands_land(tmp_path, said)
    poses_could_be_little_better(tmp_path)
    tasks_write_what_they_say(tmp_path)
    what_is_not_physical_is_called_so(tmp_path, said)


def commands_land(folder: Path, said: dict[str, str]) -> None:
    """The tutorial's run ends with a report, and with commands for every target."""
    assert "the nominal robot's position error" in said["calflow check my-robot"]
    assert {"report.pdf", "report.html"} <= {path.name for path in (folder / "runs/my-robot").iterdir()}
    commands = pd.read_csv(folder / "commands.csv")
    assert len(commands)
    assert commands["reached"].all()
    before, after = (
        (folder / name).read_text(encoding="utf-8").splitlines() for name in ("weld.ls", "weld.corrected.ls")
    )
    changed = [old for old, new in zip(before, after, strict=True) if old != new]
    assert changed
    assert all("J1=" in line or "J4=" in line for line in changed)


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
        if re.search("^from (urllib|http|socket)|^import (socket|requests)", text, re.M)
    }
    assert sending == {"source"}


@pytest.mark.parametrize("page", sorted([*DOCS.glob("*.md"), *DOCS.parent.glob("*.md")]), ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    """Fails if a page links to a file, or to a heading of one, that is not there, or a page of the site to one outside of it."""
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        path = page.parent / name if name else page
        assert path.exists(), target
        assert page.parent != DOCS or path.resolve().is_relative_to(DOCS), f"{target} is not in the site"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}, (
                target
            )
