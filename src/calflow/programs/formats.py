"""Formats: which maker's language a program is in, by its name and by how it begins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from calflow.files.problems import InputError, refuse
from calflow.files.units import LARGEST
from calflow.programs import fanuc_ls, krl, rapid, urscript
from calflow.programs.target import Maker, Program


@dataclass(frozen=True)
class Format:
    """A language: how it is called, the endings of its files' names, how it is told, and how it is read."""

    name: str
    suffixes: tuple[str, ...]
    recognised: Callable[[str], bool]
    read: Callable[[bytes], Program]


FORMATS: Mapping[Maker, Format] = {
    "rapid": Format("ABB RAPID", rapid.SUFFIXES, rapid.is_rapid, rapid.read_rapid),
    "krl": Format("KUKA KRL", krl.SUFFIXES, krl.is_krl, krl.read_krl),
    "fanuc": Format("FANUC LS", fanuc_ls.SUFFIXES, fanuc_ls.is_fanuc, fanuc_ls.read_fanuc),
    "urscript": Format("URScript", urscript.SUFFIXES, urscript.is_urscript, urscript.read_urscript),
}


def read_program(path: Path) -> Program:
    """Read a program in whichever language it is.

    Raises:
        InputError: it is in none of them, its name and its beginning disagree, or it cannot be read; with the line.
    """
    try:
        source = path.read_bytes()
    except FileNotFoundError:
        raise refuse("no such file", path) from None
    except IsADirectoryError:
        raise refuse("is a folder; expected a robot program", path) from None
    return parsed(source, path)


def parsed(source: bytes, path: Path) -> Program:
    """Read a program's bytes as the file of a name.

    Raises:
        InputError: as `read_program`.
    """
    if source[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise refuse("is UTF-16; save it as text of one byte a character, or as UTF-8", path)
    text = source.decode("latin-1")
    named = next((one for one in FORMATS.values() if path.suffix.lower() in one.suffixes), None)
    begun = [one for one in FORMATS.values() if one.recognised(text)]
    if named and not named.recognised(text):
        instead = f", but it begins as {begun[0].name} does" if begun else " and does not begin as such"
        raise refuse(f"is named like {named.name}{instead}", path, 1)
    chosen = named or (begun[0] if len(begun) == 1 else None)
    if chosen is None:
        known = ", ".join(f"{one.name} ({', '.join(one.suffixes)})" for one in FORMATS.values())
        raise refuse(f"is no robot program that calflow reads: {known}", path)
    try:
        program = chosen.read(source)
        _check_sizes(program)
        return program
    except InputError as error:
        first = error.problems[0]
        raise refuse(f"is not {chosen.name} that calflow understands: {first.message}", path, first.line) from None


def _check_sizes(program: Program) -> None:
    """Check that no number of a target is beyond what any robot has."""
    for target in program.targets:
        for k, number in enumerate(target.numbers):
            largest = LARGEST["length" if target.turn and k < 3 else "angle"]
            if not abs(number.value) <= largest:
                raise refuse(f"{target.name}: no robot has {number.text}", line=target.line)
