"""Marker elsewhere: a stated marker that rows without positions put farther off than a fit may move it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calflow.effects.geometry import Geometry
from calflow.estimation.accuracy import distances, leading_errors
from calflow.estimation.fit import Fit, fit_reweighted
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import measured_noise
from calflow.estimation.registration import marker_places, registered_model
from calflow.faults.mistake import marker_mistyped
from calflow.faults.reference import EQUATIONS
from calflow.faults.rough import FAR_BETTER
from calflow.faults.setup import SUSPECT_SCALE
from calflow.files.problems import refuse
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from calflow.robot.parts import PLACED_BOUND


@dataclass(frozen=True, eq=False)
class GeometryFit:
    """The robust fit of the geometry to all training rows; here: the data as the registered robot's."""

    here: Measurements
    model: Model
    fit: Fit

    @staticmethod
    def of(data: Measurements) -> GeometryFit | None:
        """Return the fit; None where there are too few rows."""
        nominal, here = registered_model(data)
        train = here.only(data.train)
        model = build(here.robot, (Geometry.id,), data.given, nominal.observations)
        noise = measured_noise(here, "estimated", nominal).only(data.train)
        if LeastSquares.of(model, train, noise).size < EQUATIONS * len(model.parameters):
            return None
        return GeometryFit(here, model, fit_reweighted(model, train, noise, model.prior_mean[None], "cauchy")[0])

    def errors(self, data: Measurements) -> np.ndarray:
        """Return the errors of rows in leading units, shape (n_rows, n_axes)."""
        return leading_errors(self.model, self.fit.estimate, data)

    @property
    def median(self) -> float:
        """The median error of all rows, if all are lengths [m]; nan otherwise."""
        lengths = all(one.units[0] == METRE for one in self.model.observations)
        return float(np.nanmedian(distances(self.errors(self.here)))) if lengths else float("nan")

    @property
    def markers(self) -> Mapping[str, np.ndarray]:
        """The place of each marker (3,) [m]."""
        figures = zip(self.model.parameters, self.fit.estimate, strict=True)
        found = {(p.part, p.symbol): p.figure + by for p, by in figures if p.effect == Geometry.id}
        return {
            name: np.array([found.get((name, axis), np.nan) for axis in "xyz"]) for name in self.model.robot.markers
        }


def check_markers(data: Measurements, fitted: GeometryFit) -> None:
    """Refuse, by InputError, a stated marker that explains the rows far better elsewhere, where no robot as stated does."""
    robot, before = data.robot, fitted.median
    if not before > SUSPECT_SCALE:
        return
    for name, place in zip(robot.markers, marker_places(robot), strict=True):
        marker = robot.markers[name]
        free = replace(robot, markers={**robot.markers, name: replace(marker, known=False)})
        moved = GeometryFit.of(data.on(free)) if place < 0 else None
        if moved and moved.median < before / FAR_BETTER:
            right = moved.markers[name]
            if np.abs(right - marker.point).max() > PLACED_BOUND:
                words = marker_mistyped(name, np.array(marker.point), right)
                raise refuse(f"robot file and measurements do not belong together, and no fit can correct it: {words}")
