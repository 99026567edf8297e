"""The model: CasADi functions of a robot with effects and observations over rows of measurements, compiled where it pays."""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import shlex
import shutil
import stat
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from calflow.effects import Effect, catalogue, effect_class
from calflow.effects.cause import Cause
from calflow.files.problems import nearest, refuse
from calflow.measurements.measurements import Measurements
from calflow.measurements.source import sha256
from calflow.observations import Observation, Seen
from calflow.robot.frames import placement, turning
from calflow.robot.mechanism import (
    Deflection,
    Dimensions,
    Loads,
    Posture,
    Row,
    State,
    base_place,
    marker_point,
    nominal_dimensions,
    nominal_loads,
    pose,
    state,
)
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

# Contraction and reassociation stay off, so that compiled code and CasADi's virtual machine agree to the last bit.
FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
# An operation takes about 0.3 ms to compile and saves about 4 ns per row.
WORTH_EVALUATIONS = 75_000
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
# Each iteration shrinks the distance to equilibrium by about the wind-up angle (some 1e-3), so three reach nanometres.
EQUILIBRIUM_TURNS = 3
BLOCK_ROWS, BLOCK_VALUES = 512, 1 << 15  # most rows, and values of one output, evaluated at once


Figures = Callable[..., list[Any]]


class NotCompiled(Exception):
    """Raised with the reason why a function cannot be compiled."""


def compiled(function: ca.Function, evaluations: int) -> ca.Function:
    """Return the function as machine code where that pays, else the function itself; results are identical.

    evaluations is the number of rows that the caller expects to evaluate. If compilation would pay but fails, a warning is
    logged once and only speed is lost.
    """
    try:
        return _compiled(function, evaluations) or function
    except NotCompiled as reason:
        if evaluations >= WORTH_EVALUATIONS:
            _warn(str(reason))
        return function


def hindrance() -> str:
    """Return why functions cannot be compiled, by compiling a small one; empty if they can."""
    x = ca.SX.sym("x")
    try:
        made = _compiled(ca.Function("trial", [x], [x * x]), WORTH_EVALUATIONS)
    except NotCompiled as reason:
        return str(reason)
    return "" if made else "machine code that was just made cannot be loaded"


def cache_folder() -> Path:
    """Return the folder in which machine code is cached between runs: under XDG_CACHE_HOME, or ~/.cache.

    Raises:
        NotCompiled: there is no home folder.
    """
    if asked := os.environ.get("XDG_CACHE_HOME"):
        return Path(asked) / "calflow" / "compiled"
    try:
        home = Path.home()
    except RuntimeError:
        raise NotCompiled("there is no home folder to keep machine code in; XDG_CACHE_HOME can name another") from None
    if not home.is_dir():
        raise NotCompiled(f"there is no home folder {home} to keep machine code in; XDG_CACHE_HOME can name another")
    return home / ".cache" / "calflow" / "compiled"


def _compiled(function: ca.Function, evaluations: int) -> ca.Function | None:
    """Return the function as machine code; None if it is not cached and would not pay."""
    command, folder, kind = _compiler(), cache_folder(), f"{function.name()}-{function.n_instructions()}"
    # A glob over the hundreds of files of a folder would take as long as a small fit.
    built = folder.is_dir() and any(name.startswith(f"{kind}-") for name in os.listdir(folder))
    if evaluations < WORTH_EVALUATIONS and not built:
        return None  # quicker than serialising the function
    # The key is made from the serialised function, which takes half the time of generating its C code.
    content = [function.serialize(), ca.CasadiMeta.version(), *command, *FLAGS, platform.machine()]
    digest = hashlib.sha256("\n".join(content).encode()).hexdigest()[:32]
    key = f"{kind}-{digest}"
    try:
        for library in sorted(folder.glob(f"{key}-*.so")):
            if _is_trusted(folder, library) and (loaded := _load(function, library)):
                return loaded
        return (
            None
            if evaluations < WORTH_EVALUATIONS
            else _load(function, _build(command, _source(function), folder, key))
        )
    except OSError as error:
        raise NotCompiled(f"the folder of machine code cannot be used ({error})") from None


def _source(function: ca.Function) -> str:
    """Return the function's C code."""
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    return str(generator.dump())


def _compiler() -> list[str]:
    """Return the compiler's command, from CC."""
    asked = os.environ.get("CC", "cc")
    try:
        command = shlex.split(asked)
    except ValueError as error:
        raise NotCompiled(f"CC={asked} is no command ({error})") from None
    if not command or shutil.which(command[0]) is None:
        raise NotCompiled(f"there is no C compiler '{asked}'")
    return command


def _is_trusted(folder: Path, library: Path) -> bool:
    """Return whether a library is intact: its name ends in its own SHA-256.

    Raises:
        NotCompiled: another user could have put it there.
    """
    if not stat.S_ISREG(library.lstat().st_mode):
        return False
    _check_owner(folder)
    _check_owner(library)
    return library.stem.rpartition("-")[2] == sha256(library)


def _check_owner(path: Path) -> None:
    if os.name != "posix":
        return  # file modes are meaningless there
    status = path.stat()
    if status.st_uid != os.geteuid():
        raise NotCompiled(f"{path} is not yours: machine code that somebody else put there is not loaded; remove it")
    if status.st_mode & OTHERS_WRITE:
        raise NotCompiled(
            f"others may write to {path}: machine code is not loaded from there; chmod go-w it, or remove it"
        )


def _load(function: ca.Function, library: Path) -> ca.Function | None:
    """Return the function in a library; None if it was built for another system."""
    try:
        return ca.external(function.name(), str(library))
    except RuntimeError:
        return None


def _build(command: list[str], source: str, folder: Path, key: str) -> Path:
    """Compile into the cache, atomically even if two processes build at once, and return the library."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    _check_owner(folder)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        code, built = Path(work, "function.c"), Path(work, "function.so")
        code.write_text(source)
        try:
            subprocess.run([*command, *FLAGS, str(code), "-o", str(built), "-lm"], check=True, capture_output=True)
        except subprocess.CalledProcessError as error:
            output = error.stderr.decode(errors="replace").strip().splitlines()
            # The last line often says only that compilation terminated.
            why = next((line for line in output if "error" in line), output[-1] if output else "")
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' failed{f': {why}' if why else ''}") from None
        except OSError as error:
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' cannot be run ({error})") from None
        if not built.is_file():
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' made nothing")
        built.chmod(0o700)
        with built.open("rb+") as stream:
            os.fsync(stream.fileno())
        library = folder / f"{key}-{sha256(built)}.so"
        built.replace(library)
    return library


@lru_cache
def _warn(reason: str) -> None:
    """Log, once per reason, why functions run uncompiled."""
    logging.getLogger("calflow").warning("slower, without machine code: %s", reason)


class Asked(NamedTuple):
    """The points requested by an observation: as reported by the device, and as they are on a target, (3,) [m] each."""

    reports: list[ca.SX]
    targets: list[ca.SX]


@dataclass(frozen=True, eq=False)
class SymbolicPrediction:
    """The symbolic prediction of one row, with quantities derived lazily.

    parts are the effects that act, with their parameters; dims, loads and deflection are the robot's with all effects, and loaded
    is the state under load that deflects it, None where nothing is compliant.
    """

    robot: Robot
    row: Row
    parts: tuple[tuple[Effect, ca.SX], ...]
    dims: Dimensions
    loads: Loads
    deflection: Deflection
    loaded: State | None

    @cached_property
    def state(self) -> State:
        """The state under load: torques, forces and moments."""
        return self.loaded or state(self.robot, self.dims, self.loads, self.row, self.deflection)

    @cached_property
    def point(self) -> ca.SX:
        """Position of the marker in the measuring frame, (3,) [m]."""
        return marker_point(self.robot, self.dims, self.row.q, self.deflection, self.row.marker)

    @cached_property
    def position(self) -> ca.SX:
        """Position of the marker as reported by a device in the measuring frame, (3,) [m]."""
        return self.device(self.point)

    def device(self, seen: ca.SX, name: str = "") -> ca.SX:
        """Return the position that a device of this name reports for a point (3,) in its frame."""
        for effect, part in self.parts:
            seen = effect.device(part, seen, self.row) if effect.concerns(name) else seen
        return seen

    def target(self, place: ca.SX) -> ca.SX:
        """Return the true position of a nominal point (3,) of a target, in its frame."""
        for effect, part in self.parts:
            place = effect.target(part, place, self.row)
        return place

    @cached_property
    def posture(self) -> Posture[ca.SX]:
        """All frames, relative to the base."""
        return pose(self.robot, self.dims, self.row.q, self.deflection)

    @cached_property
    def stands(self) -> ca.SX:
        """Pose of the base in the measuring frame, (4, 4)."""
        return placement(base_place(self.robot)) @ placement(self.dims.base)

    @cached_property
    def tool(self) -> ca.SX:
        """Rotation of the tool relative to the flange, (3, 3)."""
        nominal = placement(ca.DM([0, 0, 0, *(self.robot.tool_rotation or (0, 0, 0))]))
        return (nominal @ placement(ca.vertcat(0, 0, 0, self.dims.tool_rotation)))[:3, :3]

    @cached_property
    def rotation(self) -> ca.SX:
        """Rotation of the tool in the measuring frame, (3, 3)."""
        return (self.stands @ self.posture.carrying(self.robot, self.row.marker))[:3, :3] @ self.tool

    def link(self, name: str) -> ca.SX:
        """Return the frame of a link, by name, in the measuring frame, (4, 4)."""
        return self.stands @ self.posture.frame(self.robot, self.robot.link(name))

    @property
    def closure(self) -> ca.SX:
        """The cosine in the loop's closure equation; 0 without a loop."""
        return self.posture.closure.cosine if self.posture.closure else ca.SX(0)


@dataclass(frozen=True)
class Model:
    """A robot with effects; given names the optional conditions recorded with its rows (see `mechanism.Row`).

    observations are those of the data's series, whose parameters come first. probes are effects with all parameters at zero, for
    their derivatives alone: their deflections do not change the loads, which saves most work at an error of a thousandth.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    given: tuple[str, ...] = ()
    observations: tuple[Observation, ...] = ()
    probes: tuple[Effect, ...] = ()

    @property
    def parts(self) -> tuple[Observation | Effect, ...]:
        """The parts with parameters: observations, effects, probes."""
        return (*self.observations, *self.effects, *self.probes)

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """All parameters, part by part, including those held fixed, with priors by the robot's expectations."""
        stated = self.robot.expectations
        return tuple(parameter.as_expected(stated) for part in self.parts for parameter in part.declared)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, part by part."""
        return tuple(parameter for parameter in self.declared if parameter.held is None)

    def later(self, series: Measurements | None = None) -> Model:
        """Return the model for rows measured later (see `Effect.later`)."""
        later = tuple(effect.later(series) for effect in self.effects)
        return self if later == self.effects else replace(self, effects=later)

    @property
    def tool_unseen(self) -> bool:
        """Whether it is measured by what does not depend on where markers are: by images alone."""
        return bool(self.observations) and not any(observation.of_marker for observation in self.observations)

    @property
    def by_session(self) -> bool:
        """Whether sessions have frames of their own, as the study says of a station or as was found: a further one's is unknown.

        A wire whose anchor was moved between sessions leaves the frame of positions where it was.
        """
        series = [observation.series for observation in self.observations]
        stated = any(each.station.by_session for each in series)
        devices = [each.device for each in series if each.has_positions] or [each.device for each in series] or [""]
        found = [effect for effect in self.effects if "session" in effect.needs]
        return stated or any(effect.concerns(device) for effect in found for device in devices)

    def undecided(self, data: Measurements) -> np.ndarray:
        """Return the rows (n_rows,) in which the fitted rows do not tell whether some effect acts."""
        return np.logical_or.reduce([np.zeros(len(data), dtype=bool), *(each.undecided(data) for each in self.effects)])

    def columns(self, part: Observation | Effect) -> np.ndarray:
        """Return the indices of the free parameters of an observation or effect; ValueError if it is not in the model."""
        span = self._spans[self.parts.index(part)]
        return np.flatnonzero((self.free >= span.start) & (self.free < span.stop))

    def values(self, part: Observation | Effect, p: np.ndarray) -> np.ndarray:
        """Return all declared parameters of an observation or effect, given the free parameters p (n_parameters,)."""
        return self.whole(p)[self._spans[self.parts.index(part)]]

    def whole(self, p: np.ndarray) -> np.ndarray:
        """Return all declared parameters (n_declared,), given the free parameters p (n_parameters,)."""
        values = np.array([parameter.held or 0.0 for parameter in self.declared])
        values[self.free] = p
        return values

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The causes among the effects, in their order."""
        return tuple(effect for effect in self.effects if isinstance(effect, Cause))

    @cached_property
    def free(self) -> np.ndarray:
        """Indices of the free parameters among the declared ones, shape (n_parameters,)."""
        return np.flatnonzero([parameter.held is None for parameter in self.declared])

    @cached_property
    def _spans(self) -> tuple[slice, ...]:
        """The slice of each part's parameters among the declared ones."""
        return tuple(consecutive(len(part.declared) for part in self.parts))

    def _completed(self, p: ca.SX) -> ca.SX:
        """Return the declared parameters: the symbols of the free ones, and the values of those held fixed."""
        if len(self.parameters) == len(self.declared):
            return p
        values = ca.SX(ca.DM([parameter.held or 0.0 for parameter in self.declared]))
        values[self.free.tolist()] = p
        return values

    @cached_property
    def nominal(self) -> np.ndarray:
        """Nominal parameter values, shape (n_parameters,)."""
        return np.array([parameter.nominal for parameter in self.parameters])

    @cached_property
    def prior_mean(self) -> np.ndarray:
        """Prior means, shape (n_parameters,)."""
        return np.array([parameter.prior_mean for parameter in self.parameters])

    @cached_property
    def prior_sd(self) -> np.ndarray:
        """Prior standard deviations, shape (n_parameters,)."""
        return np.array([parameter.prior_sd for parameter in self.parameters])

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lower and upper bounds, shape (n_parameters, 2)."""
        return np.array([[parameter.lower, parameter.upper] for parameter in self.parameters]).reshape(-1, 2)

    @property
    def n_conditions(self) -> int:
        """Length of a packed row of conditions."""
        return sum(Row.sizes(self.robot, self.given).values())

    def expression(self, p: ca.SX, c: ca.SX, turns: int = EQUILIBRIUM_TURNS) -> SymbolicPrediction:
        """Return one row's prediction for symbols p (n_parameters,) and c (n_conditions,).

        turns is the number of fixed-point iterations in which the loads are evaluated at the deflected pose.
        """
        row, p = Row.unpack(self.robot, c, self.given), self._completed(p)
        spans = zip((*self.effects, *self.probes), self._spans[len(self.observations) :], strict=True)
        parts = tuple(effect.acts_as(p[span], row) for effect, span in spans)
        dims, loads = nominal_dimensions(self.robot), nominal_loads(self.robot)
        for effect, part in parts:
            dims = effect.dimensions(part, dims, row)
            loads = effect.loads(part, loads, row)

        still, now = Deflection.zero(self.robot.n_joints), None
        deflection = still
        for turn in range(turns if any(effect.gives_way for effect, _ in parts) else 0):
            acting = parts if turn == turns - 1 else parts[: len(self.effects)]
            now = state(self.robot, dims, loads, row, deflection)
            for effect, part in acting:
                now = replace(now, torque=now.torque + effect.torque(part, now, row))
            deflection = still
            for effect, part in acting:
                deflection += effect.deflection(part, now, row, still)
            if deflection.is_zero and not self.probes:
                break
        return SymbolicPrediction(self.robot, row, parts, dims, loads, deflection, now)

    @cached_property
    def graph(self) -> Graph:
        """The graph of this model, and of all that are equal to it."""
        return _graph(self)

    @property
    def symbols(self) -> tuple[ca.SX, ca.SX, SymbolicPrediction]:
        """Symbols of the parameters and of one row, and the prediction for them."""
        return self.graph.symbols

    def error(self, observation: Observation, asked: Asked | None = None) -> tuple[ca.SX, ca.SX]:
        """Return the symbol of one row's reported values (see `Observation.reported`), and the residual (n_units,).

        The residual is predicted minus reported; asked collects the points that the observation requests from the effects.
        """
        p, _, predicted = self.symbols
        asked = asked or Asked([], [])

        def device(point: ca.SX) -> ca.SX:
            asked.reports.append(predicted.device(point, observation.series.device))
            return asked.reports[-1]

        def target(point: ca.SX) -> ca.SX:
            asked.targets.append(predicted.target(point))
            return asked.targets[-1]

        reported = ca.SX.sym("y", observation.reports)
        values = self._completed(p)[self._spans[self.parts.index(observation)]]
        seen = Seen(
            predicted.point, lambda: predicted.rotation, device, predicted.link,
            lambda: predicted.stands[:3, :3] @ predicted.posture.down(self.robot), target,
        )  # fmt: skip
        return reported, observation.error(values, seen, reported)

    def handed_on(self, p: np.ndarray, model: Model) -> np.ndarray:
        """Return another model's parameters, with the values p (n_parameters,) of this one's where it has them, else nominal."""
        by_identity = dict(zip((parameter.identity for parameter in self.parameters), p, strict=True))
        return np.array([by_identity.get(parameter.identity, parameter.nominal) for parameter in model.parameters])

    def position(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the reported positions [m] in the measuring frame, shape (n_rows, 3), for rows (n_conditions, n_rows)."""
        return self.figures("position", lambda p, c, at: [at.position], p, conditions)[0][:, :, 0]

    def point(self, p: np.ndarray, conditions: np.ndarray, places: np.ndarray | None = None) -> np.ndarray:
        """Return the true positions (n_rows, 3) [m] of the markers, without errors of the device.

        Of other points of the last link, if places (n_rows, 3) [m] in its frame are given.
        """
        if places is None:
            return self.figures("point", lambda p, c, at: [at.point], p, conditions)[0][:, :, 0]
        frame = self.link(self.robot.links[-1], p, conditions)
        return np.asarray(np.einsum("nij,nj->ni", frame[:, :3, :3], places) + frame[:, :3, 3])

    def rotation(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the rotations of the tool in the measuring frame, shape (n_rows, 3, 3)."""
        return self.figures("rotation", lambda p, c, at: [at.rotation], p, conditions)[0]

    def link(self, name: str, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the frames (n_rows, 4, 4) of a link in the measuring frame, as `Seen.link` does."""
        return self.figures(f"link{self.robot.link(name)}", lambda p, c, at: [at.link(name)], p, conditions)[0]

    def position_jacobian(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the Jacobian of `position`, shape (n_rows, 3, n_parameters)."""
        return self.position_and_jacobian(p, conditions)[1]

    def position_and_jacobian(self, p: np.ndarray, conditions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `position` and `position_jacobian`, which share most of their work."""
        position, slope = self.figures(
            "jacobian", lambda p, c, at: [at.position, ca.jacobian(at.position, p)], p, conditions
        )
        return position[:, :, 0], slope

    def point_jacobian(self, p: np.ndarray, conditions: np.ndarray, places: np.ndarray | None = None) -> np.ndarray:
        """Return the Jacobian of `point`, shape (n_rows, 3, n_parameters)."""
        if places is None:
            return self.figures("point_jacobian", lambda p, c, at: [ca.jacobian(at.point, p)], p, conditions)[0]
        slope = self.figures(
            "link_jacobian", lambda p, c, at: [ca.jacobian(at.link(self.robot.links[-1])[:3, :], p)], p, conditions
        )[0].reshape(len(places), 4, 3, -1)  # a column of the frame after the other
        return np.asarray(np.einsum("ncip,nc->nip", slope[:, :3], places) + slope[:, 3])

    def rotation_jacobian(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the Jacobian of the tool's rotation about its own axes, shape (n_rows, 3, n_parameters)."""
        return self.figures("rotation_jacobian", lambda p, c, at: [turning(at.rotation, p)], p, conditions)[0]

    def observed_error(
        self, observation: Observation, p: np.ndarray, conditions: np.ndarray, reported: np.ndarray
    ) -> np.ndarray:
        """Return the residuals, predicted minus reported, of an observation's rows, shape (n_rows, n_units)."""
        return self.observed("error", lambda p, c, error: [error], observation, p, conditions, reported)[0][:, :, 0]

    def observed_jacobian(
        self, observation: Observation, p: np.ndarray, conditions: np.ndarray, reported: np.ndarray
    ) -> np.ndarray:
        """Return the Jacobian of `observed_error`, shape (n_rows, n_units, n_parameters)."""
        return self.observed(
            "slope", lambda p, c, error: [ca.jacobian(error, p)], observation, p, conditions, reported
        )[0]

    def closure_cosine(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the loop's closure cosine of each row, shape (n_rows,); the loop can close if it is within ±1."""
        return self.figures("closure", lambda p, c, at: [at.closure], p, conditions)[0].ravel()

    def equilibrium_error(self, p: np.ndarray, conditions: np.ndarray) -> float:
        """Return the largest displacement [m] of any row by one more iteration of the equilibrium."""

        def further(p: ca.SX, c: ca.SX, at: SymbolicPrediction) -> list[ca.SX]:
            return [self.expression(p, c, turns=EQUILIBRIUM_TURNS + 1).position - at.position]

        return float(np.linalg.norm(self.figures("further", further, p, conditions)[0], axis=1).max())

    def figures(self, name: str, of: Figures, p: np.ndarray, conditions: np.ndarray) -> list[np.ndarray]:
        """Return quantities of rows (n_conditions, n_rows), each (n_rows, *shape).

        of returns their expressions, given the symbols of the parameters and of a row and the prediction; the function is cached
        by name and code of of, so that the name must identify all that its closure holds.
        """
        key, made = (name, of.__code__), self.graph.made
        if key not in made:
            made[key] = _figures(name, self.symbols[:2], of(*self.symbols))
        return self._of_rows(made[key], p, conditions)

    def observed(
        self,
        name: str,
        of: Figures,
        observation: Observation,
        p: np.ndarray,
        conditions: np.ndarray,
        reported: np.ndarray,
    ) -> list[np.ndarray]:
        """Return quantities of an observation's residual at rows, as `figures`; of receives the residual as its third argument."""
        key, made = (f"{name}{self.observations.index(observation)}", of.__code__), self.graph.made
        if key not in made:
            (y, error), symbols = self.error(observation), self.symbols[:2]
            made[key] = _figures(key[0], (*symbols, y), of(*symbols, error))
        return self._of_rows(made[key], p, conditions, reported)

    def _of_rows(self, function: ca.Function, p: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
        values = enumerate(self.over_rows(function, p, *rows))
        return [value.T.reshape(rows[0].shape[1], *function.size_out(k)[::-1]) for k, value in values]

    def over_rows(self, function: ca.Function, p: np.ndarray, *rows: np.ndarray, passes: int = 1) -> list[np.ndarray]:
        """Evaluate a function of this model as `over_rows` does, compiled once the number of rows evaluated makes that pay.

        passes is how often these rows are expected to be evaluated.
        """
        graph = self.graph
        graph.evaluations[function] += rows[0].shape[1]
        expected = max(passes * rows[0].shape[1], graph.evaluations[function] // 2)  # half of past use may recur
        made = graph.compiled.get(function)
        if made is None or (expected >= WORTH_EVALUATIONS and made is function):
            made = graph.compiled[function] = compiled(function, expected)
        return over_rows(made, p, *rows)


@dataclass(frozen=True, eq=False)
class Graph:
    """The graph of a model, and the functions made of it: building one takes longer than the few evaluations of a fit.

    symbols: of the parameters and of one row, with the prediction for them; made: functions, by name and code; evaluations: number
    of rows for which each was evaluated, since the number of calls is not known in advance; compiled: those already looked up in
    the cache of compiled code, as a look-up takes longer than a few rows.
    """

    symbols: tuple[ca.SX, ca.SX, SymbolicPrediction]
    made: dict[Hashable, ca.Function] = field(default_factory=dict)
    evaluations: Counter[ca.Function] = field(default_factory=Counter)
    compiled: dict[ca.Function, ca.Function] = field(default_factory=dict)


@lru_cache(maxsize=64)
def _graph(model: Model) -> Graph:
    """Return the graph of a model; cached, as a search constructs equal models, or with other priors, many times."""
    p, c = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("c", model.n_conditions)
    return Graph((p, c, model.expression(p, c)))


def _figures(name: str, inputs: Sequence[ca.SX], outputs: list[Any]) -> ca.Function:
    """Return a function of the outputs, each transposed, so that values of many rows are in NumPy's row-major order."""
    return ca.Function(name, inputs, [ca.densify(ca.SX(output)).T for output in outputs])


def build(
    robot: Robot,
    effects: Sequence[str | type[Effect] | Effect],
    given: tuple[str, ...] = (),
    observations: tuple[Observation, ...] = (),
) -> Model:
    """Return the model of a robot with effects given by id, as classes, or as objects, which are applied to the robot."""
    every = (
        replace(effect, robot=robot) if isinstance(effect, Effect) else _class(effect)(robot) for effect in effects
    )
    model = Model(robot, tuple(every), given, observations)
    return replace(model, effects=tuple(effect.unseen() for effect in model.effects)) if model.tool_unseen else model


def stated(
    robot: Robot,
    effects: Sequence[str | type[Effect] | Effect],
    data: Measurements,
    observations: tuple[Observation, ...] = (),
) -> Model:
    """Return the model of a robot with effects given by id, class or object, in the variants that a study means for the rows."""
    forms = [effect if isinstance(effect, Effect) else _class(effect).stated(robot, data) for effect in effects]
    return build(robot, forms, data.given, observations)


def _class(effect: str | type[Effect]) -> type[Effect]:
    """Return the effect class of an id, or the class itself.

    Raises:
        InputError: no effect has this id.
    """
    if not isinstance(effect, str):
        return effect
    if kind := effect_class(effect):
        return kind
    raise refuse(f"unknown effect '{effect}'{nearest(effect, catalogue())}", key="effects")


def consecutive(widths: Iterable[int]) -> list[slice]:
    """Return the slices of consecutive parts, by the number of columns of each."""
    return [slice(start, end) for start, end in pairwise(accumulate(widths, initial=0))]


def side_by_side(numbers: np.ndarray) -> np.ndarray | slice:
    """Return increasing indices (n,) as a slice where they are consecutive, so that NumPy indexes without a copy."""
    if not len(numbers):
        return numbers
    first, last = int(numbers[0]), int(numbers[-1])
    return slice(first, last + 1) if last - first == len(numbers) - 1 else numbers


def over_rows(function: ca.Function, p: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """Return a function (p, row, ...) -> dense outputs evaluated over rows, each (size, n_rows); outputs side by side."""
    return bound_to_rows(function, *rows)(p)


def bound_to_rows(function: ca.Function, *rows: np.ndarray) -> Callable[[np.ndarray], list[np.ndarray]]:
    """Return p -> `over_rows` of the same rows, whose values last until the next p: to bind rows takes longer than a few of them.

    Rows are evaluated in blocks of equal size, the last overlapping the one before.
    """
    n_rows = rows[0].shape[1]
    values = [np.empty((n_rows, function.numel_out(k))) for k in range(function.n_out())]
    shown = [value.reshape(n_rows * function.size2_out(k), function.size1_out(k)).T for k, value in enumerate(values)]
    if not n_rows:
        return lambda p: shown
    most = max(1, min(BLOCK_ROWS, BLOCK_VALUES // max(1, *map(function.numel_out, range(function.n_out())))))
    size = -(-n_rows // -(-n_rows // most))
    every, mapped = np.empty((size, function.numel_in(0))), _mapped(function, size)
    contiguous = [np.ascontiguousarray(row.T) for row in rows]
    parts = [slice(start, start + size) for start in (*range(0, n_rows - size, size), n_rows - size)]
    blocks = [
        bound(mapped, [every, *(row[part] for row in contiguous)], [value[part] for value in values]) for part in parts
    ]

    def at(p: np.ndarray) -> list[np.ndarray]:
        every[:] = p
        for evaluate in blocks:
            evaluate()
        return shown

    return at


def bound(function: ca.Function, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> Callable[[], None]:
    """Return what evaluates a function on NumPy arrays in place, without copies.

    Arrays are contiguous, in CasADi's column-major order.
    """
    buffer, evaluate = function.buffer()
    for k, values in enumerate(inputs):
        buffer.set_arg(k, memoryview(values.reshape(-1)))  # type: ignore[call-arg, arg-type]
    for k, values in enumerate(outputs):
        buffer.set_res(k, memoryview(values.reshape(-1)))  # type: ignore[call-arg, arg-type]

    def evaluated(kept: object = (buffer, inputs, outputs)) -> None:  # of which CasADi knows the addresses alone
        evaluate()

    return evaluated


@lru_cache(maxsize=512)
def _mapped(function: ca.Function, n_rows: int) -> ca.Function:
    """Return the function mapped over a number of rows, cached since building it takes longer than evaluating it."""
    return function.map(n_rows)
