"""Formats: recognising a program's language by file suffix and first lines, and reading it with its parser."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from calflow.files.problems import InputError, Problem, refuse
from calflow.files.units import LARGEST
from calflow.programs import fanuc_ls, krl, rapid, urscript
from calflow.programs.statements import link
from calflow.programs.target import Maker, Program, Skipped

OTHERS = (".dat", ".ls", ".va", ".sys", ".prg")  # suffixes shared with other kinds of files in a backup


@dataclass(frozen=True)
class Format:
    """A language: its name, file suffixes, recogniser, reader, and the linker of all files of a project to programs."""

    name: str
    suffixes: tuple[str, ...]
    recognised: Callable[[str], object]
    read: Callable[[bytes, str], Any]
    link: Callable[[Sequence[Any]], tuple[list[Program], list[Problem]]]

    def misread(self, problem: Problem, path: Path) -> InputError:
        """Return the error for a file that cannot be read."""
        return refuse(f"is not {self.name} that calflow can parse: {problem.message}", path, problem.line)


FORMATS: Mapping[Maker, Format] = {
    "rapid": Format("ABB RAPID", rapid.SUFFIXES, rapid.BEGINS.match, rapid.RapidModules.of, link),
    "krl": Format("KUKA KRL", krl.SUFFIXES, krl.BEGINS.match, krl.KrlFile.of, link),
    "fanuc": Format("FANUC LS", fanuc_ls.SUFFIXES, fanuc_ls.is_fanuc, fanuc_ls.read_fanuc, fanuc_ls.link_fanuc),
    "urscript": Format("URScript", urscript.SUFFIXES, urscript.BEGINS.match, urscript.UrScript.of, link),
}


def parsed(source: bytes, path: Path) -> Program:
    """Return the program in a file's bytes.

    Raises:
        InputError: the language is unknown, suffix and content disagree, or a line cannot be parsed.
    """
    language, read = _read(source, path, path.name)
    programs, wrong = language.link([read])
    if wrong:
        raise language.misread(wrong[0], path)
    _check_sizes(programs[0], path)
    return programs[0]


def read_project(files: Mapping[str, bytes], root: Path) -> tuple[list[Program], list[tuple[str, Skipped]]]:
    """Return the programs among the files of a project, and by file why one that looks like a program cannot be read.

    root: the project's path, for messages.

    Raises:
        InputError: there are no programs, or programs of several makers or robots.
    """
    units: dict[tuple[Format, str], list[Any]] = {}
    programs: list[Program] = []
    wrong: list[Problem] = []
    tasks = sorted(set(filter(None, map(_task, files))))
    for file, source in sorted(files.items()):
        named = _named(Path(file))
        shared = Path(file).suffix.lower() in OTHERS
        if named is None or (shared and not named.recognised(source.decode("latin-1"))):
            continue
        try:
            _, read = _read(source, root / file, file)
            # Modules outside the tasks (old versions, the controller's disk) need not be loaded together with these.
            unit = _task(file) or (file if tasks else "") if named is FORMATS["rapid"] else ""
            units.setdefault((named, unit), []).append(read)
        except InputError as error:
            wrong.append(replace(error.problems[0], file=Path(file)))
    for (language, _), every in units.items():
        linked, refused = language.link(every)
        programs += linked
        wrong += [language.misread(problem, problem.file or root).problems[0] for problem in refused]
    for program in programs:
        _check_sizes(program, root / program.file)
    _check_one_robot(programs, tasks, root)
    return programs, [
        (problem.file.as_posix(), Skipped(problem.file.name, problem.line or 1, "not read", problem.message))
        for problem in wrong
        if problem.file
    ]


def _named(path: Path) -> Format | None:
    """Return the format that the suffix of a file names, if any."""
    return next((format_ for format_ in FORMATS.values() if path.suffix.lower() in format_.suffixes), None)


def _check_one_robot(programs: Sequence[Program], tasks: Sequence[str], root: Path) -> None:
    """Check that there are programs, and that they are of one maker and one task."""
    makers = sorted({FORMATS[program.maker].name for program in programs})
    moving = [task for task in tasks if any(program.targets and _task(program.file) == task for program in programs)]
    if not programs:
        raise refuse(f"holds no robot program that calflow reads: {_known()}", root)
    if len(makers) > 1:
        raise refuse(f"holds programs of several makers ({', '.join(makers)}): give the folder of one controller", root)
    if len(moving) > 1:
        several = ", ".join(moving)
        raise refuse(f"holds targets of several tasks ({several}): give the folder of the one of this robot", root)


def _task(file: str) -> str:
    """Return the task of a module of a RAPID backup, by its folder; empty if none."""
    return next((folder for folder in file.split("/")[:-1] if re.fullmatch(r"TASK\d+", folder, re.IGNORECASE)), "")


def _read(source: bytes, path: Path, file: str) -> tuple[Format, Any]:
    """Return the format of a file and its parsed content; file: its name in the project."""
    if source[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise refuse("is UTF-16; save it in UTF-8 or an 8-bit encoding", path)
    text = source.decode("latin-1")
    named = _named(path)
    begun = [format_ for format_ in FORMATS.values() if format_.recognised(text)]
    if named and not named.recognised(text):
        instead = f"begins like {begun[0].name}" if begun else "does not begin like it"
        raise refuse(f"has the suffix of {named.name}, but {instead}", path, 1)
    chosen = named or (begun[0] if len(begun) == 1 else None)
    if chosen is None:
        raise refuse(f"is no robot program that calflow reads: {_known()}", path)
    try:
        return chosen, chosen.read(source, file)
    except InputError as error:
        raise chosen.misread(error.problems[0], path) from None


def _known() -> str:
    return ", ".join(f"{format_.name} ({', '.join(format_.suffixes)})" for format_ in FORMATS.values())


def _check_sizes(program: Program, path: Path) -> None:
    """Check that the numbers of all targets are within the range of any robot."""
    for target in program.targets:
        for k, number in enumerate(target.numbers):
            largest = LARGEST["length" if target.turn and k < 3 else "angle"]
            if not abs(number.value) <= largest:
                raise refuse(f"{target.name}: no robot has {number.text}", path, target.line)
