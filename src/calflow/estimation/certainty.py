"""Certainty: how sure a calibrated model's own positions are, apart from the device that measures them."""

from __future__ import annotations

import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.rival_models import choice_variance
from calflow.files.units import RADIAN

PART_ROWS = 100_000  # whose Jacobian is there at once: enough for machine code to pay
UNTOLD = 0.5  # of a direction's prior variance: what is left above it was hardly measured


def position_variance(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the variance of each row's predicted position per axis, shape (n_rows, 3) [m²].

    It holds what is not known of the parameters, the choice of the model, and the model's own discrepancy, which no further
    measurement of the same poses takes away; of a residual field its own variance in the discrepancy's place. Where the noise was
    estimated from the fit discrepancy and noise cannot be told apart, and both are in.
    """
    told = parameter_variance(known, conditions)
    of_choice = choice_variance(known.alternatives, known.model, known.estimate, conditions)
    return np.asarray(told + of_choice + left_variance(known, conditions))


def parameter_variance(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the variance of each row's predicted position per axis that is the parameters' (n_rows, 3) [m²], part by part."""
    parts = np.array_split(conditions, range(PART_ROWS, conditions.shape[1], PART_ROWS), axis=1)
    slopes = (known.model.point_jacobian(known.estimate, part) for part in parts)
    return np.concatenate([of_parameters(slope, known.covariance) for slope in slopes])


def left_variance(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the variance of what positions err by beside parameters and choice of model, alike along all axes (n_rows, 1) [m²]."""
    if known.field:
        return np.asarray(known.field.variance(readings(known, conditions))[:, None])
    return np.full((conditions.shape[1], 1), unexplained(known) ** 2)


def expected_point(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return where the markers are to be expected, shape (n_rows, 3) [m]: by the model, and its residual field if it has one."""
    return known.model.point(known.estimate, conditions) + field_correction(known, conditions)


def field_correction(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return what the residual field adds to the model's points, shape (n_rows, 3) [m]: nothing where there is none."""
    return known.field.correction(readings(known, conditions)) if known.field else np.zeros((conditions.shape[1], 3))


def readings(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the joint readings (n_rows, n_joints) of packed conditions."""
    return np.asarray(conditions[: known.model.robot.n_joints].T)


def rotation_variance(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the variance of each row's predicted orientation about the tool's own axes, shape (n_rows, 3) [rad²].

    What no measurement told of is as sure as its prior says (see `untold_turns`).
    """
    jacobian = known.model.rotation_jacobian(known.estimate, conditions)
    return of_parameters(jacobian, known.covariance) + known.discrepancy[RADIAN] ** 2


def untold_turns(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the share (3,) of the variance of the tool's turn about each own axis that no measurement told anything of.

    It comes from the directions of the parameters, scaled by their priors, whose variance the data left above UNTOLD of
    what the priors alone make it; mean over the rows.
    """
    sd = known.model.prior_sd
    left, directions = np.linalg.eigh(known.covariance / np.outer(sd, sd))
    turned = known.model.rotation_jacobian(known.estimate, conditions) @ (sd[:, None] * directions)
    parts = (turned**2).mean(axis=0) * np.maximum(left, 0.0)
    total = parts.sum(axis=1)
    return np.asarray(np.divide(parts[:, left > UNTOLD].sum(axis=1), total, out=np.zeros(3), where=total > 0))


def unexplained(known: CalibratedModel) -> float:
    """Return the standard deviation per axis [m] of what the model errs by beside its parameters' errors, at any pose."""
    return float(np.hypot(known.unexplained_length, known.elsewhere))


def of_parameters(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variance (n_rows, 3) of what depends on the parameters by a Jacobian (n_rows, 3, n_parameters)."""
    return np.asarray(np.einsum("nai,ij,naj->na", jacobian, covariance, jacobian, optimize=True))
