"""Functions of the joint angles that know no robot, fitted to what geometry leaves: radial basis, Gaussian process, network."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.base import RegressorMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV, GroupKFold
from sklearn.neural_network import MLPRegressor
from sklearn.preprocessing import StandardScaler

from calflow.measurements.measurements import Measurements
from prior_methods.method import Predictor, timed
from prior_methods.physical import calibrated

FOLDS = 3
KERNEL_ROWS = 300  # from which a process learns its lengths: time grows with their cube
SEED = 1


@dataclass(frozen=True)
class AfterGeometry(ABC):
    """A function of the joint angles, and of which marker it is, to the three coordinates that geometry leaves [mm]."""

    name: str

    def lacking(self, train: Measurements) -> str:
        """Nothing."""
        return ""

    @abstractmethod
    def learnt(self, x: np.ndarray, y: np.ndarray, poses: np.ndarray) -> RegressorMixin:
        """Return the function of x (n_rows, n_inputs) fitted to y (n_rows, 3), both standardised.

        Rows that poses (n_rows,) name alike belong together.
        """

    @timed
    def fit(self, train: Measurements) -> Predictor:
        """Fit geometry, then the function to what it leaves."""
        geometry = calibrated(train, "geometry")
        scale, size = StandardScaler().fit(inputs(train)), StandardScaler()
        left = size.fit_transform(1e3 * (train.position - geometry.positions(train)))
        function: Any = self.learnt(scale.transform(inputs(train)), left, train.table["pose"].to_numpy())

        def positions(rows: Measurements) -> np.ndarray:
            moved = size.inverse_transform(function.predict(scale.transform(inputs(rows))))
            return geometry.positions(rows) + moved / 1e3

        return positions


def inputs(rows: Measurements) -> np.ndarray:
    """Return the joint angles, and a column a marker that is 1 where the row is of it."""
    markers = [rows.table["marker"] == name for name in rows.robot.markers]
    return np.column_stack([rows.joints, *(markers if len(markers) > 1 else ())]).astype(float)


@dataclass(frozen=True)
class RadialBasis(AfterGeometry):
    """Gaussian radial basis functions at all training rows; width and ridge by cross-validation over poses."""

    name: str = "geometry + radial basis functions"

    def learnt(self, x: np.ndarray, y: np.ndarray, poses: np.ndarray) -> RegressorMixin:
        """Solve for the weights."""
        tried = {"gamma": np.geomspace(0.01, 1, 4), "alpha": np.geomspace(1e-3, 1, 4)}
        return GridSearchCV(KernelRidge(kernel="rbf"), tried, cv=GroupKFold(FOLDS)).fit(x, y, groups=poses)


@dataclass(frozen=True)
class GaussianProcess(AfterGeometry):
    """A Gaussian process with a length a joint, by marginal likelihood."""

    name: str = "geometry + Gaussian process"

    def learnt(self, x: np.ndarray, y: np.ndarray, poses: np.ndarray) -> RegressorMixin:
        """Learn the lengths from some rows and the function from all."""
        kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(np.ones(x.shape[1]), (1e-2, 1e3)) + WhiteKernel(
            0.1, (1e-4, 1e1)
        )
        some = np.random.default_rng(SEED).permutation(len(x))[:KERNEL_ROWS]
        lengths = GaussianProcessRegressor(kernel).fit(x[some], y[some]).kernel_
        return GaussianProcessRegressor(lengths, optimizer=None).fit(x, y)


@dataclass(frozen=True)
class NeuralNetwork(AfterGeometry):
    """A network of two small layers; its weights' decay by cross-validation over poses."""

    name: str = "geometry + neural network"

    def learnt(self, x: np.ndarray, y: np.ndarray, poses: np.ndarray) -> RegressorMixin:
        """Train it."""
        network = MLPRegressor(
            hidden_layer_sizes=(20, 20), activation="tanh", solver="lbfgs", max_iter=300, random_state=SEED
        )
        tried = {"alpha": (0.01, 0.1, 1.0, 10.0)}
        with warnings.catch_warnings():  # to stop before it has settled keeps it from learning the noise
            warnings.simplefilter("ignore", ConvergenceWarning)
            return GridSearchCV(network, tried, cv=GroupKFold(FOLDS)).fit(x, y, groups=poses)
