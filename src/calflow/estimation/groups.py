"""Groups of rows: the members of each, and parts that tear none apart, in time that grows with the rows alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def members(group: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each group, in their order; group (n_rows,) numbers them from 0 without gaps."""
    return np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1])


def whole_groups(group: np.ndarray, size: int) -> Iterator[slice]:
    """Yield rows in parts of about a size, none of which ends between neighbours of one group (n_rows,)."""
    ends, start = np.append(np.flatnonzero(np.diff(group)) + 1, len(group)), 0
    while start < len(group):
        end = int(ends[np.searchsorted(ends, min(start + size, len(group)))])
        yield slice(start, end)
        start = end
