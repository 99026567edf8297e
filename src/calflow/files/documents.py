"""Documents: what a run keeps as JSON, each declared once as a dataclass whose fields are `tables.column`s.

None stands for what cannot be told. Keys carry their unit, as columns do.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from calflow.files.problems import refuse

Document = Mapping[str, Any]
Documents = Mapping[str, Document]
Kind = TypeVar("Kind")

SUM = "sha256"  # the key of the sum of all the others, by which a turned bit is noticed
DIGITS = 15  # of a number: those that a clock's seconds since 1970 need, without the last, which rounding disturbs


def to_document(value: Any) -> Document:
    """Return a dataclass as JSON's values; a number that is not finite becomes None."""
    return {name: _plain(own) for name, own in asdict(value).items()}


def from_document(document: Document, kind: type[Kind]) -> Kind:
    """Return a document as its dataclass; what the dataclass does not know is left out.

    Raises:
        InputError: a value is missing or of another type.
    """
    try:
        return TypeAdapter(kind).validate_python(dict(document))
    except ValidationError as error:
        said = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
        raise refuse(f"a summary of calflow was changed ({said}); run the study again") from None


def sealed(document: Document) -> Document:
    """Return a document with a sum of itself."""
    return {**document, SUM: _sum(document)}


def is_whole(document: Document) -> bool:
    """Return whether a document is as it was sealed; one without a sum is of an earlier version, and counts as whole."""
    content = {name: value for name, value in document.items() if name != SUM}
    return SUM not in document or document[SUM] == _sum(content)


def _sum(document: Document) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(name): _plain(own) for name, own in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(own) for own in value]
    if hasattr(value, "item"):  # of NumPy
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value
