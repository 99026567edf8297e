"""A workplace: a study of all stages with two runs, what is asked of them, a plant, and every command that reads these."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from pathlib import Path

from conftest import SMALL, Answer, Folder, in_process
from fleet.plant import built
from trouble.kills import EVERY
from trouble.studies import ON_URDF, URDF

PROGRAM = """/PROG  POINTS
/ATTR
/MN
   1:J P[1] 100% FINE    ;
/POS
P[1]{
   GP1:
\tUF : 0, UT : 1,\t
\tJ1=    10.000 deg,\tJ2=   -30.000 deg,\tJ3=    60.000 deg
};
/END
"""
FRAMES = '[frames.bench]\nwithin = "base"\norigin_mm = [100, 0, 0]\nrotation_deg = [0, 0, 90]\n'
MADE = "made"  # where commands of a workplace write

OF_FILES = {  # what a user writes, as one of these commands reads it
    "check": ("check", "."),
    "plan": ("plan", ".", "--out", "runs"),
    "run": ("run", ".", "--stage", "identify", "--out", f"{MADE}/run"),
    "next": ("next", ".", "--number", "2", "--out", f"{MADE}/next"),
    "simulate": ("simulate", "truth.toml", "--out", f"{MADE}/simulated.csv"),
    "plan of a URDF": ("plan", "urdf"),
    "new from a URDF": ("new", f"{MADE}/new", "--robot", "urdf/arm.urdf", "--tip", "tool0"),
    "next with rows": ("next", ".", "--rows", "new.csv", "--number", "2", "--out", f"{MADE}/next"),
    "predict": ("predict", "runs", "rows.csv", "--out", f"{MADE}/predicted.csv"),
    "compensate": ("compensate", "runs", "targets.csv", "--frames", "frames.toml", "--out", f"{MADE}/commands.csv"),
    "filter": ("filter", "runs", "points.ls", "--payload", "heavy", "--out", f"{MADE}/points.ls"),
    "check-poses": ("check-poses", "runs", "measurements.csv", "--out", f"{MADE}/poses.csv"),
    "validate": ("validate", "runs", "new.csv", "--out", f"{MADE}/validated"),
    "drift": ("drift", "runs", "new.csv", "--out", f"{MADE}/drift"),
    "fleet": ("fleet", "plan", "plant/plant.toml", "--out", f"{MADE}/fleet"),
}  # fmt: skip
READ = {  # the files that each of them reads, besides a run
    "check": ("study.toml", "robot.toml", "quick.toml", "measurements.csv"),
    "plan": ("study.toml", "robot.toml", "quick.toml", "measurements.csv"),
    "run": ("study.toml", "robot.toml", "quick.toml", "measurements.csv"),
    "next": ("study.toml", "robot.toml", "measurements.csv"),
    "simulate": ("truth.toml", "robot.toml"),
    "plan of a URDF": ("urdf/arm.urdf", "urdf/robot.toml"),
    "new from a URDF": ("urdf/arm.urdf",),
    "next with rows": ("new.csv",),
    "predict": ("rows.csv",),
    "compensate": ("targets.csv", "frames.toml"),
    "filter": ("points.ls",),
    "check-poses": ("measurements.csv",),
    "validate": ("new.csv",),
    "drift": ("new.csv",),
    "fleet": ("plant/plant.toml", "plant/type/study.toml", "plant/type/robot.toml"),
}
OF_RUNS = {  # commands that read a run folder
    "status": ("status", "runs"),
    "plan": OF_FILES["plan"],
    "predict": OF_FILES["predict"],
    "compensate": ("compensate", "runs", "targets.csv", "--out", f"{MADE}/commands.csv"),
    "filter": OF_FILES["filter"],
    "check-poses": OF_FILES["check-poses"],
    "export": ("export", "runs", "--to", "json"),
    "export of figures": ("export", "runs", "--to", "controller"),
    "validate": OF_FILES["validate"],
    "drift": OF_FILES["drift"],
    "compare": ("compare", "runs", "later", "--out", f"{MADE}/compared"),
    "history": ("history", "later", "runs", "--out", f"{MADE}/history"),
    "pack": ("pack", "runs", "--out", f"{MADE}/run.zip"),
    "report": ("report", "runs"),
    "run": ("run", ".", "--out", "runs"),
    "reproduce": ("reproduce", "runs"),
}


@dataclass(frozen=True)
class Workplace:
    """A folder with all that commands read."""

    path: Path

    def ask(self, arguments: tuple[str, ...]) -> Answer:
        """Call the command line there."""
        with self.here():
            return in_process(*arguments)

    @contextmanager
    def here(self) -> Iterator[None]:
        """Be there, with nothing made yet."""
        shutil.rmtree(self.path / MADE, ignore_errors=True)
        (self.path / MADE).mkdir()
        with chdir(self.path):
            yield

    def made(self) -> dict[str, bytes]:
        """What a command has made there, by name."""
        found = (self.path / MADE).rglob("*")
        return {path.relative_to(self.path).as_posix(): path.read_bytes() for path in sorted(found) if path.is_file()}


def workplace(path: Path, workflow: str = EVERY) -> Workplace:
    """Build a workplace in a folder; the second run is of other measurements of the same robot."""
    place = Folder(path)
    path.mkdir(parents=True)
    for name, text in (SMALL | {"quick.toml": workflow, "frames.toml": FRAMES}).items():
        (place / name).write_text(text, encoding="utf-8")
    (place / "points.ls").write_bytes(PROGRAM.replace("\n", "\r\n").encode())
    _asked("simulate", place / "truth.toml")
    first = (place / "measurements.csv").read_bytes()
    place.edit("truth.toml", ("seed = 3", "seed = 4"))
    _asked("simulate", place / "truth.toml", "--out", place / "new.csv")
    place.edit("truth.toml", ("seed = 4", "seed = 3"))
    shutil.copy(place / "new.csv", place / "measurements.csv")
    _asked("run", path, "--stage", "identify", "--out", place / "later")
    (place / "measurements.csv").write_bytes(first)
    _asked("run", path, "--out", place / "runs")
    rows = place.rows[:8:2]
    place.measure(rows.drop(columns=["x_mm", "y_mm", "z_mm", "sigma_mm"]), "rows.csv")
    place.measure(rows.drop(columns=["sigma_mm", "repeat"]).assign(frame="measuring"), "targets.csv")
    built(place / "plant", place / "measurements.csv")
    _urdf(place / "urdf")
    return Workplace(path)


@contextmanager
def few_sections() -> Iterator[None]:
    """Let reports have two sections only, so that they take no longer than all the rest."""
    from calflow.reporting import document as written

    every = written.sections
    written.sections = lambda: every()[:2]  # type: ignore[assignment]
    try:
        yield
    finally:
        written.sections = every


def _urdf(folder: Path) -> None:
    folder.mkdir()
    files = SMALL | {"robot.toml": ON_URDF, "arm.urdf": URDF, "truth.toml": SMALL["truth.toml"].replace("a_mm", "y_mm")}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    _asked("simulate", folder / "truth.toml")


def _asked(*command: object) -> None:
    answer = in_process(*command)
    assert answer.code == 0, answer
