"""Calibrations from simulated devices, held against the truth: tool error against what is promised, and intervals."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.design.candidates import packed_conditions
from calflow.effects.geometry import Geometry
from calflow.estimation.fit import Fit, fit, fit_reweighted
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import measured_noise
from calflow.estimation.registration import registered
from calflow.measurements.measurements import Measurements, combined
from calflow.measurements.series import BeamNoise, Series, Station
from calflow.model import Model, build
from calflow.observations import observations
from calflow.robot.parts import Base
from calflow.robot.robot import Robot
from hidden.devices import Arm, Tracker, measured, seen, sockets, wire
from robots import figures, placed

Array = np.ndarray
NOISE = 1e-4  # m, of a wire and of a ball in its socket
ANCHOR, SOCKET, APART = np.array([1.2, 0.5, 0.1]), np.array([0.7, 0.2, 0.1]), np.array([0.03, 0.04, 0.0])
A, B = np.array([3.0, 0.2, 0.4, 0.0, 0.0, 1.0]), np.array([-2.0, 2.5, 0.4, 0.02, -0.01, -2.0])
BEAM = BeamNoise(1e-5, 5e-6, 5e-6)
TASK = 400  # random poses over which the tool's error is averaged


@dataclass(frozen=True)
class Error:
    """Root mean square error of the tool over random poses [m]: what it is, and what the fit's covariance promises."""

    true: float
    promised: float


def by_wire(arm: Arm, rng: np.random.Generator, stated: Mapping[str, object] = MappingProxyType({})) -> Measurements:
    """Return 60 lengths of a wire whose anchor nobody knows, unless it is stated."""
    table = wire(arm, arm.random(60, rng), ANCHOR, NOISE, rng)
    return measured(arm.robot, table, Series.of("", "distance", {"offset": 0.0, "scale": 0.0, **stated}), NOISE)


def by_sockets(arm: Arm, rng: np.random.Generator) -> Measurements:
    """Return 60 touches of each of two sockets that are 50 mm apart."""
    table = sockets(arm, {"a": SOCKET, "b": SOCKET + APART}, 60, NOISE, rng)
    return measured(arm.robot, table, Series.of("", "same-point", {"distance": 0.05}, labels=("socket",)), NOISE)


def tool_error(nominal: Robot, observe: Callable[[Arm, np.random.Generator], Measurements], seed: int) -> Error:
    """Calibrate a robot drawn at random, and compare its tool with the truth where no frame is known: aligned."""
    rng = np.random.default_rng(seed)
    arm = Arm.drawn(nominal, rng)
    return error_of_tool(calibrated(observe(arm, rng), ("geometry",)).fit, arm, TASK, rng)


def error_of_tool(found: Fit, arm: Arm, poses: int, rng: np.random.Generator) -> Error:
    """Compare a fit's tool with an arm's at random poses where no frame is known: aligned."""
    q = arm.random(poses, rng)
    conditions = packed_conditions(found.model, q, "", next(iter(arm.robot.markers)))
    points, jacobian = (
        found.model.point(found.estimate, conditions),
        found.model.point_jacobian(found.estimate, conditions),
    )
    return Error(aligned(points, arm.tool(q)), promised(points, jacobian, found.covariance))


@dataclass(frozen=True)
class Calibrated:
    """A fit, the noise of its first series, and that with what the model leaves besides [m]."""

    fit: Fit
    sigma: float
    left: float


def calibrated(data: Measurements, effects: tuple[str, ...]) -> Calibrated:
    """Fit a robot's effects to training rows, registration and noise included."""
    robot, observed = registered(data.robot, observations(data), data)
    data = data.on(robot)
    model = build(robot, effects, data.given, observed)
    noise = measured_noise(data, "auto", build(robot, (), data.given, observed))
    found, noise, _, _ = fit_reweighted(model, data, noise, model.nominal[None], "linear")
    return Calibrated(found, float(noise.sigma[0]), float(noise.total[0]))


def aligned(said: Array, true: Array) -> float:
    """Root mean square of what a rigid motion leaves between two sets of points (n, 3)."""
    said, true = said - said.mean(axis=0), true - true.mean(axis=0)
    turn, _ = Rotation.align_vectors(true, said)
    return float(np.sqrt(((turn.apply(said) - true) ** 2).sum(axis=1).mean()))


def promised(points: Array, jacobian: Array, covariance: Array) -> float:
    """Root mean square of the points' standard deviations, freed of rigid motions."""
    n = len(points)
    arm = points - points.mean(axis=0)
    motions = np.concatenate(
        [np.tile(np.eye(3), (n, 1, 1)), np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2)], axis=2
    )
    basis = np.linalg.qr(motions.reshape(3 * n, 6))[0]
    whole = jacobian.reshape(3 * n, -1)
    whole = whole - basis @ (basis.T @ whole)
    return float(np.sqrt(np.einsum("ni,ij,nj->", whole, covariance, whole, optimize=True) / n))


@dataclass(frozen=True)
class Stations:
    """A tracker in two stations that nobody knows: the model that all simulated calibrations share."""

    nominal: Robot
    model: Model
    robot: Robot

    @staticmethod
    def of(nominal: Robot) -> Stations:
        """Register the stations by one simulated calibration."""
        nominal = replace(nominal, base=Base(known=False))
        data = _seen(
            Arm(replace(nominal, base=Base()), figures(replace(nominal, base=Base()))),
            nominal,
            np.random.default_rng(0),
        )
        robot, observed = registered(nominal, observations(data), data)
        return Stations(nominal, build(robot, ("geometry",), data.given, observed), robot)

    def z(self, seed: int) -> Array:
        """Draw a robot from the priors, calibrate it, and return every parameter's error in its standard deviations."""
        rng = np.random.default_rng(seed)
        flat = replace(self.nominal, base=Base())
        true = figures(flat)
        (geometry,) = self.model.effects
        assert isinstance(geometry, Geometry)
        drawn = {}
        for error in geometry.errors:
            own = error.parameter
            if error.field == "base":
                continue
            value = own.prior_sd * rng.standard_normal() * (1.0 if own.joint else 0.1)
            drawn[own.name] = value
            if own.joint:
                true[own.symbol][own.joint - 1] += value
            else:
                true["markers"]["xyz".index(own.symbol), 0] += value
                registered_at = self.robot.markers[own.part].point["xyz".index(own.symbol)]
                drawn[own.name] += self.nominal.markers[own.part].point["xyz".index(own.symbol)] - registered_at
        data = _seen(Arm(flat, true), self.nominal, rng).on(self.robot)
        noise = measured_noise(data, "file")
        found, _ = fit(LeastSquares.of(self.model, data, noise))
        ((station, place),) = self.model.observations[1].placements.items()
        in_a = np.linalg.inv(placed(A))
        drawn |= _six("base", (*self.robot.base.origin, *self.robot.base.rotation), in_a)
        drawn |= _six(station, place, in_a @ placed(B))
        names = [parameter.name for parameter in self.model.parameters]
        truth = np.array([drawn[name] for name in names])
        return (found.estimate - truth) / np.sqrt(np.diag(found.covariance))


def _six(part: str, nominal: tuple[float, ...], true: Array) -> dict[str, float]:
    """What a frame errs by from its registered place, by the parameters' names."""
    off = np.linalg.inv(placed(np.array(nominal))) @ true
    values = (*off[:3, 3], *Rotation.from_matrix(off[:3, :3]).as_euler("XYZ"))
    return {f"{part}.{symbol}": float(v) for symbol, v in zip(("x", "y", "z", "rx", "ry", "rz"), values, strict=True)}


def _seen(arm: Arm, nominal: Robot, rng: np.random.Generator) -> Measurements:
    """Return 40 poses from each station."""
    parts = []
    for name, at in (("A", A), ("B", B)):
        table = seen(arm, arm.random(40, rng), Tracker(at, BEAM.floor, BEAM.growth, BEAM.angle), rng)
        parts.append(measured(nominal, table, Series(name, "position", Station(name), BEAM)))
    return combined(parts)


@dataclass(frozen=True)
class LeftOut:
    """Mean distance [m] of a ball's computed centres from their socket's mean, and the processor's seconds a fit."""

    mean: float
    seconds: tuple[float, ...]


def left_out_in_turn(data: Measurements, effects: tuple[str, ...]) -> LeftOut:
    """Fit all placements but one, and judge by that one, each in turn.

    No effects: of geometry alone and with gravity deflection the one with the better BIC on the fitted placements.
    """
    data = replace(data, table=data.table.assign(split="train"))
    placement = data.table["placement"].to_numpy()
    distances, seconds = [], []
    for name in dict.fromkeys(placement):
        train, own = data.only(placement != name), data.only(placement == name)
        begin = _processor()
        choices = (effects,) if effects else (("geometry",), ("geometry", "gravity-deflection"))
        found = min((calibrated(train, choice) for choice in choices), key=_bic).fit
        seconds.append(_processor() - begin)
        points = found.model.point(found.estimate, own.on(found.model.robot).conditions)
        for socket in own.table["socket"].unique():
            there = points[(own.table["socket"] == socket).to_numpy()]
            distances.append(np.linalg.norm(there - there.mean(axis=0), axis=1))
    return LeftOut(float(np.concatenate(distances).mean()), tuple(seconds))


def _bic(found: Calibrated) -> float:
    """Schwarz's criterion of a calibration whose noise the fit tells."""
    n = found.fit.residual.size
    return 2 * n * float(np.log(found.sigma)) + found.fit.effective_parameters * float(np.log(n))


def _processor() -> float:
    """Seconds of this process and its children."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system
