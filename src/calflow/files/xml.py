"""XML as a tree of frozen elements that keep their line numbers for error messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from calflow.files.problems import refuse
from calflow.files.toml import read_text


@dataclass(frozen=True)
class Element:
    """An element: its tag, attributes, first line and child elements; text content is omitted."""

    tag: str
    attributes: Mapping[str, str]
    line: int
    inside: tuple[Element, ...]

    def all(self, tag: str) -> Iterator[Element]:
        """Yield the direct children with a tag."""
        return (element for element in self.inside if element.tag == tag)


def read_xml(path: Path) -> Element:
    """Return the root element of an XML file; entity declarations are refused.

    Raises:
        InputError: the file cannot be read or is not XML.
    """
    text = read_text(path)
    parser = expat.ParserCreate(encoding="utf-8")
    begun: list[tuple[str, Mapping[str, str], int]] = []
    inside: list[list[Element]] = [[]]

    def start(tag: str, attributes: dict[str, str]) -> None:
        begun.append((tag, attributes, parser.CurrentLineNumber))
        inside.append([])

    def end(_: str) -> None:
        within = tuple(inside.pop())
        inside[-1].append(Element(*begun.pop(), within))

    def entity(*_: object) -> None:
        raise refuse("declares an entity of its own, which is not read", path, parser.CurrentLineNumber)

    parser.StartElementHandler, parser.EndElementHandler, parser.EntityDeclHandler = start, end, entity
    try:
        parser.Parse(text.encode("utf-8"), True)
    except expat.ExpatError as error:
        raise refuse(f"not XML: {expat.ErrorString(error.code)}", path, error.lineno) from None
    return inside[0][0]
