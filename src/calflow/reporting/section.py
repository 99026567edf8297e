"""What a section of the report is, and how sections are found: each `Section` that a file in sections/ defines."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from calflow.deployment.usability import AT_THE_ROBOT, Advice, Rule, mistake_unsettled
from calflow.files.tables import Results
from calflow.reporting.blocks import Block
from calflow.reporting.material import Material
from calflow.study import StudyFile

WRONG = 2  # urgency up to which something is wrong or missing; what could be better may be left


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

    def is_served(self, results: Results) -> bool:
        """Whether its tables are there."""
        return all(path in results for path in self.needs)

    def tells(self, material: Material) -> bool:
        """Whether its tables are there and hold something to tell."""
        results = material.results
        return self.is_served(results) and self.asked(material.request) and self.worth_telling(results)


def sections() -> list[Section]:
    """Return all sections in their order."""
    from calflow.reporting import sections as folder

    modules = [
        importlib.import_module(f"{folder.__name__}.{module.name}") for module in pkgutil.iter_modules(folder.__path__)
    ]
    every = dict.fromkeys(part for module in modules for part in vars(module).values() if isinstance(part, Section))
    return sorted(every, key=lambda section: section.order)


def advise(urgency: int, sentence: str, where: object = True, effort: int = AT_THE_ROBOT) -> list[Advice]:
    """Return advice, where there is reason for it."""
    return [Advice(urgency, sentence, effort)] if where else []


def advice(every: Sequence[Section], results: Results) -> list[Advice]:
    """Return what all sections advise, the most urgent first, of those alike what takes least; an unsettled mistake alone."""
    if unsettled := mistake_unsettled(results):
        return unsettled
    items = [
        item for section in every if section.is_served(results) for rule in section.rules for item in rule(results)
    ]
    return sorted(items, key=lambda item: (item.urgency, item.effort))
