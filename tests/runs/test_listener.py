"""The listener: what a run tells, in an order that makes sense."""

from __future__ import annotations

from calflow.estimation.progress import onward


def test_progress_never_goes_back():
    """Fails if a bar jumps back where a stage finds that more is left to do, or an advance is not passed on."""
    told = []
    advance = onward(told.append)
    for share in (0.1, 0.5, 0.3, 0.5, 0.9, 0.2):
        advance(share)
    assert told == [0.1, 0.5, 0.5, 0.5, 0.9, 0.9]
