"""HTML elements: whatever is not an element itself is escaped where it enters one."""

from __future__ import annotations

import json
import re
from html import escape

VOID = frozenset({"img", "input", "meta"})  # elements that hold nothing and have no end
UNSPEAKABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ufdd0-\ufdef\ufffe\uffff]")  # what HTML may not hold


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str | int | bool) -> Html:
    """Return an element; an attribute that is True stands alone, one that is False or empty is left out.

    Names are written with - for _, and class_ and for_ without it.
    """
    said = "".join(_attribute(name.rstrip("_").replace("_", "-"), value) for name, value in attributes.items())
    inside = "".join(map(shown, children))
    return Html(f"<{tag}{said}>" if tag in VOID else f"<{tag}{said}>{inside}</{tag}>")


def shown(text: str) -> Html:
    """Return text as HTML that shows it letter by letter, and HTML as it is."""
    return text if isinstance(text, Html) else Html(escape(UNSPEAKABLE.sub("\ufffd", text), quote=False))


def as_json(value: object) -> Html:
    """Return a value as JSON that a script's element holds: nothing in it ends the element."""
    return Html(json.dumps(value, separators=(",", ":")).replace("<", "\\u003c"))


def joined(parts: list[Html]) -> Html:
    """Return elements one after the other."""
    return Html("\n".join(parts))


def _attribute(name: str, value: str | int | bool) -> str:
    if value is True:
        return f" {name}"
    if value is False or value == "":
        return ""
    return f' {name}="{escape(UNSPEAKABLE.sub("�", str(value)))}"'
