"""The figures of a fit or a diagnosis, as the report draws them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from calflow.reporting.material import Material
from calflow.reporting.sections.residuals import by_joint, by_place, in_space
from calflow.reporting.style import style


@dataclass(frozen=True)
class Plots:
    """Figures of Matplotlib; `.savefig(path)` writes one."""

    material: Callable[[], Material]

    def residuals(self) -> Figure:
        """Draw the position errors against each joint's reading."""
        return self._drawn(by_joint)

    def residuals_by_place(self) -> Figure:
        """Draw the errors' size against reach, height and row."""
        return self._drawn(by_place)

    def residuals_in_space(self) -> Figure:
        """Draw the errors in the workspace, enlarged."""
        return self._drawn(in_space)

    def _drawn(self, draw: Callable[[Material], Figure]) -> Figure:
        with style():
            return draw(self.material())
