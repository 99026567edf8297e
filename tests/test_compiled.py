"""Compiled functions: the same bits, built once, and not needed."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import robots
from calflow import model as module
from calflow.model import WORTH_EVALUATIONS, Model, build, cache_folder, compiled, over_rows


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CC", raising=False)
    return cache_folder()


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is said of functions that stay uncompiled, as it comes."""
    module._warn.cache_clear()
    said: list[str] = []
    monkeypatch.setattr(logging.getLogger("calflow"), "warning", lambda text, *values: said.append(text % values))
    return said


@pytest.fixture(scope="module")
def model() -> Model:
    """A robot with a loop, springs and wrong figures."""
    return build(robots.hh800(), ["geometry", "joint-compliance"])


@pytest.fixture(scope="module")
def point(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Parameters and rows for it."""
    rng = np.random.default_rng(10)
    p = np.concatenate([rng.normal(scale=3e-3, size=31), rng.uniform(0, 2e-7, 6)])
    return p, robots.rows(model, robots.poses(model.robot, 400), "rated")


def function(name: str = "toy", factor: float = 3.0) -> ca.Function:
    """A small function (p, row) -> (1,) of one row."""
    p, c = ca.SX.sym("p", 2), ca.SX.sym("c", 3)
    return ca.Function(name, [p, c], [ca.sin(p[0] * c[0]) + factor * c[1] * p[1] - ca.sqrt(ca.fabs(c[2])) / 7])


def is_compiled(function: ca.Function) -> bool:
    """Whether it is machine code."""
    return "External" in function.class_name()


@pytest.mark.parametrize("name", ["position", "rotation", "closure"])
def test_same_bits_as_the_virtual_machine(model: Model, point: tuple[np.ndarray, np.ndarray], name: str) -> None:
    """Breaks if a compiler flag lets machine code contract or reassociate what CasADi computes."""
    model.figures(name, lambda p, c, at: [getattr(at, name)], *point)
    (plain,) = (made for (key, _), made in model.graph.made.items() if key == name)
    built = compiled(plain, WORTH_EVALUATIONS)
    assert is_compiled(built)
    assert not is_compiled(plain)
    assert np.array_equal(over_rows(built, *point)[0], over_rows(plain, *point)[0])


@pytest.mark.parametrize(("variable", "value"), [("PATH", ""), ("CC", "no-such-compiler"), ("CC", "false")])
def test_does_without_a_compiler(monkeypatch: pytest.MonkeyPatch, cache: Path, variable: str, value: str) -> None:
    """Breaks if a missing or failing compiler raises, changes a number, or leaves a broken library behind."""
    rng = np.random.default_rng(11)
    p, rows = rng.normal(size=2), rng.normal(size=(3, 50))
    wanted = over_rows(compiled(function(), WORTH_EVALUATIONS), p, rows)[0]
    for library in cache.glob("*"):
        library.unlink()
    monkeypatch.setenv(variable, value)
    found = compiled(function(), WORTH_EVALUATIONS)
    assert not is_compiled(found)
    assert np.array_equal(over_rows(found, p, rows)[0], wanted)
    assert not list(cache.glob("*"))


def test_cache_that_cannot_be_written_does_no_harm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a cache folder that is no folder raises."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert not is_compiled(compiled(function(), WORTH_EVALUATIONS))


def test_builds_once(monkeypatch: pytest.MonkeyPatch, cache: Path) -> None:
    """Breaks if a second call compiles again, or a few rows do not profit from what is built already."""
    compiled(function(), WORTH_EVALUATIONS)
    (library,) = cache.glob("*")
    before = library.stat()

    def build_again(*_: object) -> bool:
        raise AssertionError("compiled again")

    monkeypatch.setattr(module, "_build", build_again)
    for evaluations in (WORTH_EVALUATIONS, 1):
        assert is_compiled(compiled(function(), evaluations))
    assert list(cache.glob("*")) == [library]
    assert (library.stat().st_mtime_ns, library.stat().st_ino) == (before.st_mtime_ns, before.st_ino)


def scribbled(library: Path) -> None:
    """Half a file, as a machine that lost its power leaves it."""
    library.write_bytes(library.read_bytes()[: library.stat().st_size // 2])


def flipped(library: Path) -> None:
    """One bit turned, which the system's loader may not see."""
    content = bytearray(library.read_bytes())
    content[len(content) // 2] ^= 1
    library.write_bytes(content)


@pytest.mark.parametrize("damage", [scribbled, flipped])
def test_a_damaged_library_is_built_anew(cache: Path, damage: Callable[[Path], None]) -> None:
    """Fails if a library that is not whole is loaded (half a file is a bus error), or never replaced."""
    compiled(function("damaged"), WORTH_EVALUATIONS)
    (library,) = cache.glob("*")
    damage(library)
    assert not is_compiled(compiled(function("damaged"), 1))
    assert is_compiled(compiled(function("damaged"), WORTH_EVALUATIONS))
    assert is_compiled(compiled(function("damaged"), 1))
    assert list(cache.glob("*")) == [library]


def own_mode(cache: Path, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library.chmod(0o722)


def folder_mode(cache: Path, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.chmod(0o777)


def owner(cache: Path, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.geteuid()
    monkeypatch.setattr(module.os, "geteuid", lambda: real + 1)


@pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
@pytest.mark.parametrize("put", [own_mode, folder_mode, owner])
def test_a_library_that_others_could_have_put_there_is_not_loaded(
    cache: Path, monkeypatch: pytest.MonkeyPatch, told: list[str], put: Callable[..., None]
) -> None:
    """Fails if machine code of another user runs in this user's name, or that it does not run is not said."""
    compiled(function(), WORTH_EVALUATIONS)
    (library,) = cache.glob("*")
    put(cache, library, monkeypatch)
    assert not is_compiled(compiled(function(), WORTH_EVALUATIONS))
    assert len(told) == 1
    assert str(cache) in told[0]


def test_a_link_is_not_loaded(cache: Path, tmp_path: Path) -> None:
    """Fails if the check of the owner can be passed by a link to a file that changes later."""
    compiled(function(), WORTH_EVALUATIONS)
    (library,) = cache.glob("*")
    (tmp_path / "elsewhere.so").write_bytes(library.read_bytes())
    library.unlink()
    library.symlink_to(tmp_path / "elsewhere.so")
    assert not is_compiled(compiled(function(), 1))


NOWHERE = {
    "a CC that is no command": ({"CC": '"'}, 'CC=" is no command'),
    "no compiler": ({"CC": "no-such-compiler"}, "no C compiler 'no-such-compiler'"),
    "a compiler that fails": ({"CC": "false"}, "the C compiler 'false' failed"),
    "a compiler that makes nothing": ({"CC": "true"}, "the C compiler 'true' made nothing"),
    "a closed cache": ({"XDG_CACHE_HOME": "/proc"}, "the folder of machine code cannot be used"),
    "a missing home": ({"XDG_CACHE_HOME": "", "HOME": "/nonexistent"}, "there is no home folder /nonexistent"),
}


@pytest.mark.skipif(os.name != "posix", reason="folders of POSIX")
@pytest.mark.parametrize(("environment", "expected"), NOWHERE.values(), ids=NOWHERE)
def test_what_keeps_it_from_compiling_is_said_once(
    monkeypatch: pytest.MonkeyPatch, told: list[str], environment: dict[str, str], expected: str
) -> None:
    """Fails if a machine without compiler or cache ends the run, is slow without a word, or says so for every function."""
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    for factor in (3.0, 4.0):
        assert not is_compiled(compiled(function(factor=factor), WORTH_EVALUATIONS))
    (said,) = told
    assert said.startswith("slower, without machine code: ")
    assert expected in said


def test_few_rows_are_not_worth_a_compilation(cache: Path) -> None:
    """Breaks if the compiler runs for evaluations that the virtual machine finishes sooner."""
    assert not is_compiled(compiled(function(), WORTH_EVALUATIONS - 1))
    assert not cache.exists()


def test_each_function_has_its_own_library(cache: Path) -> None:
    """Breaks if two functions that differ in one number only share a library."""
    p, row = np.ones(2), np.ones((3, 1))
    three, four = (compiled(function(factor=factor), WORTH_EVALUATIONS) for factor in (3.0, 4.0))
    assert len(list(cache.glob("*.so"))) == 2
    assert over_rows(four, p, row)[0] - over_rows(three, p, row)[0] == pytest.approx(1.0)


def test_cache_stays_out_of_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if XDG_CACHE_HOME is ignored, or an empty one means the working directory."""
    assert cache_folder().is_relative_to(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    assert cache_folder() == Path.home() / ".cache" / "calflow" / "compiled"
