"""Distance: a draw-wire sensor or ball bar, which reports the distance of the marker from an anchor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Self

import casadi as ca
import numpy as np
import scipy

from calflow.files.deferred import pd
from calflow.files.toml import FileModel, Length, Lengths3, Unit
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import NOWHERE, Links, OfThings, Seen, six
from calflow.robot.parts import PLACED_BOUND, PLACED_SD, UNKNOWN_BOUND, UNKNOWN_SD, Parameter

OFFSET_SD, OFFSET_BOUND = 0.02, 0.5  # m: zero of the wire
SCALE_SD, SCALE_BOUND = 1e-3, 0.05  # relative error of the drum's circumference
ROUGH = 5e-3  # m: typical error of a nominal robot, when the anchor is located


class DistanceSettings(FileModel):
    """The known figures: anchor in the measuring frame (approximate if anchor_known is false), offset and scale."""

    anchor: Lengths3 | None = None
    anchor_known: bool = True
    offset: Length | None = None
    scale: Annotated[float, Unit("ratio")] | None = None


@dataclass(frozen=True)
class Distance(OfThings):
    """length = (1 + scale) · |marker - anchor| + offset; figures stated in the settings are known, the others are fitted.

    Settings: anchor (3,) [m] in the measuring frame, anchor_known (false: approximate), offset [m], scale [m/m].
    """

    found: float = 0.0  # m: the zero estimated at registration, where it is not stated
    near: bool = False  # whether a known anchor is only near its stated place beside the base, which nothing places

    id = "distance"
    title = "length of a wire or a bar"
    columns = Reported({"length": "length"})
    settings = DistanceSettings
    units = (METRE,)

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation with the anchor stated in the settings."""
        return cls.at(series, series.triple("anchor") or NOWHERE)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return the observation with the anchor stated in the settings."""
        if series.setting("anchor") is None:
            raise ValueError(
                "state where the wire's anchor is, roughly: anchor_mm = [x, y, z] and anchor_known = false"
            )
        return cls.of(series, pd.DataFrame())

    @property
    def anchor(self) -> tuple[float, float, float]:
        """Nominal position of the anchor (3,) [m]."""
        return self.nominal[0][:3]

    @property
    def _zero(self) -> float:
        """The length reported at the anchor [m], nominally."""
        return self.series.number("offset") or self.found

    @property
    def _unknown(self) -> tuple[str, ...]:
        """The figures that are not stated, or roughly, among anchor, offset and scale."""
        rough = self.series.setting("anchor_known", True) is False
        unsaid = (name for name in ("anchor", "offset", "scale") if self.series.setting(name) is None)
        return tuple(dict.fromkeys([*(["anchor"] if rough else []), *unsaid]))

    @property
    def _open(self) -> tuple[str, ...]:
        """The figures to be fitted, the anchor first."""
        return tuple(dict.fromkeys([*(["anchor"] if self.near else []), *self._unknown]))

    def beside_base(self) -> Self:
        """Return the wire whose anchor is near its stated place beside the base: a zero of joint 1 moves it about axis 1."""
        return replace(self, near=True)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the anchor's position, the offset and the scale, so far as they are unknown."""
        known = "anchor" not in self._unknown
        sd, bound = (PLACED_SD, PLACED_BOUND) if known else (UNKNOWN_SD, UNKNOWN_BOUND)
        axes = [
            self._error(axis, "m", sd, bound, self.anchor[k], f"anchor of {self.part}, {axis}")
            for k, axis in enumerate("xyz")
        ]
        zero = self._error("offset", "m", OFFSET_SD, OFFSET_BOUND, self.found, f"zero of {self.part}")
        scale = self._error("scale", "1", SCALE_SD, SCALE_BOUND, 0.0, f"scale of {self.part}")
        every = {"anchor": axes, "offset": [zero], "scale": [replace(scale, of_size=True)]}
        return tuple(error for what, errors in every.items() if what in self._open for error in errors)

    def _error(self, symbol: str, unit: str, sd: float, bound: float, figure: float, meaning: str) -> Parameter:
        return Parameter(self.id, self.part, symbol, unit, sd, -bound, bound, figure=figure, meaning=meaning)

    @property
    def reports(self) -> int:
        """Number of values: one length."""
        return 1

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the lengths."""
        return table["length"].to_numpy(float)[None]

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the predicted minus the reported length."""
        at = 0
        anchor = ca.SX(ca.DM(self.anchor))
        if "anchor" in self._open:
            anchor, at = anchor + p[:3], 3
        offset, scale = ca.SX(self._zero), ca.SX(self.series.number("scale") or 0.0)
        if "offset" in self._open:
            offset, at = offset + p[at], at + 1
        if "scale" in self._open:
            scale = p[at]
        return (1 + scale) * ca.norm_2(seen.device(seen.point) - anchor) + offset - y

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Return the observation with unknown anchor and zero located by trilateration from the nominal robot's points."""
        free = np.repeat([name in self._unknown for name in ("anchor", "offset")], [3, 1])
        if not free.any():
            return self
        length, stated = table["length"].to_numpy(float), np.array([*self.anchor, self._zero])
        # |point|² - 2 point·anchor + |anchor|² = length² is linear in the anchor and |anchor|².
        system = np.column_stack([-2 * points, np.ones(len(points))])
        begin = np.linalg.lstsq(system, (length - self._zero) ** 2 - (points**2).sum(axis=1), rcond=None)[0][:3]

        def placed(x: np.ndarray) -> np.ndarray:
            whole = stated.copy()
            whole[free] = x
            return whole

        def weighed(x: np.ndarray) -> np.ndarray:
            *anchor, zero = placed(x)
            return np.append((np.linalg.norm(points - anchor, axis=1) + zero - length) / ROUGH, zero / OFFSET_SD)

        *anchor, zero = placed(scipy.optimize.least_squares(weighed, np.append(begin, 0.0)[free], loss="soft_l1").x)
        return replace(self, nominal=(six(anchor),), found=float(zero) if free[3] else 0.0)

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the lengths."""
        scale = self.series.number("scale") or 0.0
        return ((1 + scale) * np.linalg.norm(points - np.array(self.anchor), axis=1) + self._zero)[None]
