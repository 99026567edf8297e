"""pandas, loaded when the first of its names is asked for: commands that read no table answer without waiting for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pandas import *  # noqa: F403


def __getattr__(name: str) -> Any:
    """Return a name of pandas."""
    import pandas

    return getattr(pandas, name)
