"""What a section of the report is, and how sections are found: each `Section` that a file in sections/ defines."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from calflow.deployment.usability import Advice, Rule
from calflow.files.results import Results
from calflow.reporting.blocks import Block
from calflow.reporting.material import Material
from calflow.study_file import StudyFile


@dataclass(frozen=True)
class Section:
    """A part of the report: where it stands, the tables and documents it cannot do without, how it is written, what it advises.

    rules turn them into advice for the first page; they apply where they are there. worth_telling says
    whether the section has anything to say, asked whether the study asks for it.
    """

    order: int
    title: str
    needs: tuple[str, ...]
    write: Callable[[Material], list[Block]]
    rules: tuple[Rule, ...] = ()
    worth_telling: Callable[[Results], bool] = lambda results: True
    asked: Callable[[StudyFile], bool] = lambda request: True


def sections() -> list[Section]:
    """Return all sections in their order."""
    from calflow.reporting import sections as folder

    modules = [
        importlib.import_module(f"{folder.__name__}.{module.name}") for module in pkgutil.iter_modules(folder.__path__)
    ]
    every = dict.fromkeys(one for module in modules for one in vars(module).values() if isinstance(one, Section))
    return sorted(every, key=lambda section: section.order)


def chosen(every: Sequence[Section], material: Material) -> list[Section]:
    """Return the sections whose tables are there and hold something to tell."""
    there = [section for section in every if _served(section, material.results) and section.asked(material.request)]
    return [section for section in there if section.worth_telling(material.results)]


def advice(every: Sequence[Section], results: Results) -> list[Advice]:
    """Return what all sections advise, the most urgent first."""
    found = [item for section in every if _served(section, results) for rule in section.rules for item in rule(results)]
    return sorted(found, key=lambda item: item.urgency)


def _served(section: Section, results: Results) -> bool:
    return all(path in results for path in section.needs)
