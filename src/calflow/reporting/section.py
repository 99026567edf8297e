"""Sections of the report, discovered as the `Section`s that files in sections/ define."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass

from calflow.reporting.blocks import Block
from calflow.reporting.material import Material


@dataclass(frozen=True)
class Section:
    """A section of the report: its position, its function, and the table or document that it requires.

    Anything else that it uses must come from the same stage. has_content: whether study and results give it content.
    """

    order: int
    title: str
    needs: str
    write: Callable[[Material], list[Block]]
    has_content: Callable[[Material], bool]

    def applies(self, material: Material) -> bool:
        """Whether its table exists and it has content."""
        return (not self.needs or self.needs in material.results) and self.has_content(material)


def section(
    order: int, title: str, needs: str, has_content: Callable[[Material], bool] = lambda material: True
) -> Callable[[Callable[[Material], list[Block]]], Section]:
    """Make a section of the decorated function, which writes it."""
    return lambda write: Section(order, title, needs, write, has_content)


def sections() -> list[Section]:
    """Return all sections in order."""
    from calflow.reporting import sections as folder

    modules = [
        importlib.import_module(f"{folder.__name__}.{module.name}") for module in pkgutil.iter_modules(folder.__path__)
    ]
    every = dict.fromkeys(part for module in modules for part in vars(module).values() if isinstance(part, Section))
    return sorted(every, key=lambda section: section.order)
