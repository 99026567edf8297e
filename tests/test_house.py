"""The house: which room may import which, that a name and a file stand for one thing each, and that no error hides."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src" / "calflow"
FLOORS = (  # an import points to a floor further up this list, or stays within its room
    ("files",),
    ("robot",),
    ("measurements",),
    ("observations", "effects"),
    ("model",),
    ("estimation",),
    ("faults", "diagnosis", "sampling", "population"),
    ("design", "linear"),
    ("deployment",),
    ("programs", "importing", "stage_settings"),
    ("study", "templates"),
    ("simulation", "run_folder"),
    ("reporting",),
    ("calibration",),
    ("stages",),
    ("runs",),
    ("fleet",),
    ("commands",),
    ("__init__", "cli"),
    ("__main__",),
)
FEWEST_LINES = 50  # of a file with one importer
REGISTERED = ("effects", "observations")  # rooms of parts, a file each, that are found by their id
FLOOR = {room: k for k, floor in enumerate(FLOORS) for room in floor}


@cache
def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for path in SOURCE.rglob("*.py"):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)] = path
    return found


@cache
def parsed(path: Path) -> ast.Module:
    """A file as a tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(name: str, path: Path) -> frozenset[str]:
    """Every module of the package that a file imports, wherever in it the import stands."""
    return frozenset(_imports(name, path))


def _imports(name: str, path: Path) -> Iterator[str]:
    known = modules()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            asked = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            asked = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for one in asked:
            inner = one.removeprefix("calflow.") if one.startswith("calflow.") else ""
            while inner and inner not in known:
                inner = inner.rpartition(".")[0]
            if inner and inner != name:
                yield inner


def room(module: str) -> str:
    """The room of a module."""
    return module.partition(".")[0]


def is_registered_part(name: str, path: Path) -> bool:
    """Whether a module holds a part that its room's register finds: a class that states its id."""
    classes = (node for node in parsed(path).body if isinstance(node, ast.ClassDef))
    targets = (target for c in classes for inner in c.body if isinstance(inner, ast.Assign) for target in inner.targets)
    return room(name) in REGISTERED and any(ast.unparse(target) == "id" for target in targets)


def test_every_arrow_points_down():
    """Fails if a room imports one that stands on it, or beside it, or if a room has no floor yet."""
    wrong = [
        f"{name} imports {other}"
        for name, path in modules().items()
        for other in imports(name, path)
        if room(name) != room(other) and FLOOR[room(other)] >= FLOOR[room(name)]
    ]
    assert not wrong


def test_no_two_files_need_each_other():
    """Fails if imports go round in a circle, also through a function or for types alone."""
    graph = {name: imports(name, path) for name, path in modules().items()}
    TopologicalSorter(graph).prepare()


def test_no_name_stands_for_three_files():
    """Fails if a reader who looks for a file by its name finds it three times; a command's file is named as the user calls it."""
    names = Counter(
        name.rpartition(".")[2]
        for name, path in modules().items()
        if path.stem not in ("__init__", "base") and room(name) != "commands"
    )
    assert not [name for name, number in names.items() if number > 2]


def test_no_public_name_stands_for_two_things():
    """Fails if a class or a function that others may use is called as another one elsewhere in the house."""
    names = Counter(
        node.name
        for path in modules().values()
        for node in parsed(path).body
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_")
    )
    assert not sorted(name for name, number in names.items() if number > 1)


def test_what_is_small_lives_with_its_caller():
    """Fails if a file of a few lines serves a single other one; what a register finds serves that too."""
    importers = Counter(
        other for name, path in modules().items() for other in imports(name, path) if other.rpartition(".")[0] != name
    )
    small = {
        name
        for name, path in modules().items()
        if path.stem != "__init__"
        and not is_registered_part(name, path)
        and importers[name] == 1
        and len(path.read_text().splitlines()) < FEWEST_LINES
    }
    assert not small


def test_no_error_is_caught_unseen():
    """Fails if bugs are caught together with what a user, or the machine, can do wrong."""
    handlers = [
        f"{name}:{node.lineno}"
        for name, path in modules().items()
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.ExceptHandler)
        and not any(isinstance(inner, ast.Raise) for inner in node.body)
        and (node.type is None or ast.unparse(node.type) in ("Exception", "BaseException"))
    ]
    assert not handlers


def test_what_is_said_goes_through_one_place():
    """Fails if a command prints by itself, past what spells out the signs that a terminal would obey."""
    told = [
        name for name, path in modules().items() if "click.echo(" in path.read_text() or " print(" in path.read_text()
    ]
    assert told == ["commands.console"]
