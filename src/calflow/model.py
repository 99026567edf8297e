"""The graph: a robot and a list of effects become CasADi functions over rows of measurements, compiled where that is worth it."""

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
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from calflow.effects import Effect, catalogue, effect_class
from calflow.files.problems import nearest, refuse
from calflow.measurements.measurements import Measurements
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
# An operation takes some 0.3 ms to compile and saves some 4 ns a row.
WORTH_EVALUATIONS = 75_000
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
# Each turn shrinks the distance to equilibrium by about the wind-up angle (some 1e-3), so three reach nanometres.
EQUILIBRIUM_TURNS = 3
BLOCK_ROWS, BLOCK_VALUES = 512, 1 << 15  # rows and values of one output evaluated at once: more take longer to prepare


Figures = Callable[..., list[Any]]


class NotCompiled(Exception):
    """Why there is no machine code, to be told to the user once."""


def compiled(function: ca.Function, evaluations: int) -> ca.Function:
    """Return the function as machine code where that pays, else the function itself; results are the same.

    evaluations is how many rows the caller expects to evaluate. Where machine code would pay and cannot be had, that is
    logged once as a warning, and nothing changes but speed.
    """
    try:
        return _compiled(function, evaluations) or function
    except NotCompiled as reason:
        if evaluations >= WORTH_EVALUATIONS:
            _tell(str(reason))
        return function


def hindrance() -> str:
    """Return what keeps functions from being compiled, by compiling a small one; empty where nothing does."""
    x = ca.SX.sym("x")
    try:
        made = _compiled(ca.Function("trial", [x], [x * x]), WORTH_EVALUATIONS)
    except NotCompiled as reason:
        return str(reason)
    return "" if made else "machine code that was just made cannot be loaded"


def cache_folder() -> Path:
    """Where machine code is kept between runs: under XDG_CACHE_HOME, or ~/.cache.

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
    """Return the function as machine code; None where it is not there and would not pay."""
    command, folder, kind = _compiler(), cache_folder(), f"{function.name()}-{function.n_instructions()}"
    # A folder holds hundreds: to match them all by a pattern takes as long as a small fit.
    built = folder.is_dir() and any(name.startswith(f"{kind}-") for name in os.listdir(folder))
    if evaluations < WORTH_EVALUATIONS and not built:
        return None  # that takes less time than to write the function out
    # What the code is made from: CasADi writes it out in half the time that it takes to make the code, which is seldom needed.
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
    """Whether a library is whole: its name ends in its own SHA-256.

    Raises:
        NotCompiled: others than its user could have put it there.
    """
    if not stat.S_ISREG(library.lstat().st_mode):
        return False
    _check_owner(folder)
    _check_owner(library)
    return library.stem.rpartition("-")[2] == _sha256(library)


def _check_owner(path: Path) -> None:
    if os.name != "posix":
        return  # modes say nothing there
    status = path.stat()
    if status.st_uid != os.geteuid():
        raise NotCompiled(f"{path} is not yours: machine code that somebody else put there is not loaded; remove it")
    if status.st_mode & OTHERS_WRITE:
        raise NotCompiled(
            f"others may write to {path}: machine code is not loaded from there; chmod go-w it, or remove it"
        )


def _load(function: ca.Function, library: Path) -> ca.Function | None:
    """Return what a library holds; None where it is made for another system."""
    try:
        return ca.external(function.name(), str(library))
    except RuntimeError:
        return None


def _build(command: list[str], source: str, folder: Path, key: str) -> Path:
    """Compile into the cache and return the library: whole or not at all, also when two processes build at once."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    _check_owner(folder)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        code, built = Path(work, "function.c"), Path(work, "function.so")
        code.write_text(source)
        try:
            subprocess.run([*command, *FLAGS, str(code), "-o", str(built), "-lm"], check=True, capture_output=True)
        except subprocess.CalledProcessError as error:
            output = error.stderr.decode(errors="replace").strip().splitlines()
            # The last line may say no more than that it ended.
            why = next((line for line in output if "error" in line), output[-1] if output else "")
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' failed{f': {why}' if why else ''}") from None
        except OSError as error:
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' cannot be run ({error})") from None
        if not built.is_file():
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' made nothing")
        built.chmod(0o700)
        with built.open("rb+") as stream:
            os.fsync(stream.fileno())
        library = folder / f"{key}-{_sha256(built)}.so"
        built.replace(library)
    return library


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@lru_cache
def _tell(reason: str) -> None:
    """Say once why functions run uncompiled."""
    logging.getLogger("calflow").warning("slower, without machine code: %s", reason)


class Asked(NamedTuple):
    """What an observation asked effects for: what the device reports of points, and where points of a target are, (3,) [m] each."""

    reports: list[ca.SX]
    targets: list[ca.SX]


@dataclass(frozen=True, eq=False)
class SymbolicPrediction:
    """What the graph says of one row, each figure worked out when it is asked for.

    parts are the effects with their parameters; dims, loads and deflection are what they made of the robot, and loaded is the state
    that deflects it, None where nothing gives way.
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
        """What the loads do."""
        return self.loaded or state(self.robot, self.dims, self.loads, self.row, self.deflection)

    @cached_property
    def point(self) -> ca.SX:
        """Where the marker is in the measuring frame, (3,) [m]."""
        return marker_point(self.robot, self.dims, self.row.q, self.deflection, self.row.marker)

    @cached_property
    def position(self) -> ca.SX:
        """What a device in the measuring frame reports of it, (3,) [m]."""
        return self.device(self.point)

    def device(self, seen: ca.SX) -> ca.SX:
        """Return what a device reports of a point (3,) in its frame."""
        for effect, part in self.parts:
            seen = effect.device(part, seen, self.row)
        return seen

    def target(self, place: ca.SX) -> ca.SX:
        """Return where a point (3,) of a target is on it."""
        for effect, part in self.parts:
            place = effect.target(part, place, self.row)
        return place

    @cached_property
    def posture(self) -> Posture[ca.SX]:
        """All frames in the base's."""
        return pose(self.robot, self.dims, self.row.q, self.deflection)

    @cached_property
    def stands(self) -> ca.SX:
        """The base in the measuring frame, (4, 4)."""
        return placement(base_place(self.robot)) @ placement(self.dims.base)

    @cached_property
    def tool(self) -> ca.SX:
        """How the tool is turned on the flange, (3, 3)."""
        nominal = placement(ca.DM([0, 0, 0, *(self.robot.tool_rotation or (0, 0, 0))]))
        return (nominal @ placement(ca.vertcat(0, 0, 0, self.dims.tool_rotation)))[:3, :3]

    @cached_property
    def rotation(self) -> ca.SX:
        """How the tool is turned in the measuring frame, (3, 3)."""
        return (self.stands @ self.posture.carrying(self.robot, self.row.marker))[:3, :3] @ self.tool

    def link(self, name: str) -> ca.SX:
        """Return the frame of the link of a name in the measuring frame, (4, 4)."""
        return self.stands @ self.posture.frame(self.robot, self.robot.link(name))

    @property
    def closure(self) -> ca.SX:
        """The cosine of the loop's closure."""
        return self.posture.closure.cosine if self.posture.closure else ca.SX(0)


@dataclass(frozen=True)
class Model:
    """A robot with effects; given names the optional conditions that its rows have (see `conditions.Row`).

    observations are those of the data's series, whose own parameters come first. probes are effects at nothing, for derivatives
    alone: what they move does not change the loads, which saves most of the work and leaves out a thousandth of their effect.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    given: tuple[str, ...] = ()
    observations: tuple[Observation, ...] = ()
    probes: tuple[Effect, ...] = ()

    @property
    def parts(self) -> tuple[Observation | Effect, ...]:
        """All that has parameters: observations, effects, probes."""
        return (*self.observations, *self.effects, *self.probes)

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """All parameters, part by part, as the robot's expectations have them: those that are held, too."""
        stated = self.robot.expectations
        return tuple(parameter.as_expected(stated) for part in self.parts for parameter in part.declared)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that are variables, part by part."""
        return tuple(parameter for parameter in self.declared if parameter.held is None)

    def columns(self, part: Observation | Effect) -> np.ndarray:
        """Return the indices of the parameters of an observation or an effect; ValueError where the model does not have it."""
        span = self._spans[self.parts.index(part)]
        return np.flatnonzero((self.free >= span.start) & (self.free < span.stop))

    def values(self, part: Observation | Effect, p: np.ndarray) -> np.ndarray:
        """Return all parameters of an observation or an effect, as it declares them, for parameters p (n_parameters,)."""
        return self.whole(p)[self._spans[self.parts.index(part)]]

    def whole(self, p: np.ndarray) -> np.ndarray:
        """Return the values of all that is declared, (n_declared,), for parameters p (n_parameters,)."""
        values = np.array([parameter.held or 0.0 for parameter in self.declared])
        values[self.free] = p
        return values

    @cached_property
    def free(self) -> np.ndarray:
        """Where the parameters are among all that is declared, shape (n_parameters,)."""
        return np.flatnonzero([parameter.held is None for parameter in self.declared])

    @cached_property
    def _spans(self) -> tuple[slice, ...]:
        """Where each part's parameters are among all that is declared."""
        ends = np.cumsum([0, *(len(part.declared) for part in self.parts)])
        return tuple(slice(int(i), int(j)) for i, j in pairwise(ends))

    def _completed(self, p: ca.SX) -> ca.SX:
        """The symbols of the parameters with the values of those that are held between them."""
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
        """Length of a packed row."""
        return sum(Row.sizes(self.robot, self.given).values())

    def expression(self, p: ca.SX, c: ca.SX, turns: int = EQUILIBRIUM_TURNS) -> SymbolicPrediction:
        """Return one row's prediction for symbols p (n_parameters,) and c (n_conditions,).

        turns is how often the loads are evaluated anew at the deflected pose.
        """
        row, p = Row.unpack(self.robot, c, self.given), self._completed(p)
        spans = zip((*self.effects, *self.probes), self._spans[len(self.observations) :], strict=True)
        parts = tuple((effect, p[span]) for effect, span in spans)
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
    def symbols(self) -> tuple[ca.SX, ca.SX, SymbolicPrediction]:
        """Symbols for the parameters and one row, and the prediction they give."""
        p, c = ca.SX.sym("p", len(self.parameters)), ca.SX.sym("c", self.n_conditions)
        return p, c, self.expression(p, c)

    def error(self, observation: Observation, asked: Asked | None = None) -> tuple[ca.SX, ca.SX]:
        """Return a symbol for what one row reports (see `Observation.reported`), and predicted minus reported (n_units,).

        asked collects what the observation asks the effects for.
        """
        p, _, predicted = self.symbols
        asked = asked or Asked([], [])

        def device(point: ca.SX) -> ca.SX:
            asked.reports.append(predicted.device(point))
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
        """Return another model's parameters as they are among this one's (n_parameters,), nominal where it has none of them."""
        there = dict(zip((parameter.identity for parameter in self.parameters), p, strict=True))
        return np.array([there.get(parameter.identity, parameter.nominal) for parameter in model.parameters])

    def position(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return what a device in the measuring frame reports [m], shape (n_rows, 3), for rows (n_conditions, n_rows)."""
        return self.figures("position", lambda p, c, at: [at.position], p, conditions)[0][:, :, 0]

    def point(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return where the markers are [m], whatever a device makes of it, shape (n_rows, 3)."""
        return self.figures("point", lambda p, c, at: [at.point], p, conditions)[0][:, :, 0]

    def rotation(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return predicted rotations, shape (n_rows, 3, 3)."""
        return self.figures("rotation", lambda p, c, at: [at.rotation], p, conditions)[0]

    def link(self, name: str, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the frames (n_rows, 4, 4) of a link in the measuring frame, as `Seen.link` has them."""
        return self.figures(f"link{self.robot.link(name)}", lambda p, c, at: [at.link(name)], p, conditions)[0]

    def position_jacobian(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the positions' derivatives, shape (n_rows, 3, n_parameters)."""
        return self.position_and_jacobian(p, conditions)[1]

    def position_and_jacobian(self, p: np.ndarray, conditions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `position` and `position_jacobian`, which share most of their work."""
        position, slope = self.figures(
            "jacobian", lambda p, c, at: [at.position, ca.jacobian(at.position, p)], p, conditions
        )
        return position[:, :, 0], slope

    def point_jacobian(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the points' derivatives, shape (n_rows, 3, n_parameters)."""
        return self.figures("point_jacobian", lambda p, c, at: [ca.jacobian(at.point, p)], p, conditions)[0]

    def rotation_jacobian(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return how the tool turns about its own axes by each parameter, shape (n_rows, 3, n_parameters)."""
        return self.figures("rotation_jacobian", lambda p, c, at: [turning(at.rotation, p)], p, conditions)[0]

    def observed_error(
        self, observation: Observation, p: np.ndarray, conditions: np.ndarray, reported: np.ndarray
    ) -> np.ndarray:
        """Return predicted minus reported, shape (n_rows, n_units), of rows and what an observation packs of them."""
        return self.observed("error", lambda p, c, error: [error], observation, p, conditions, reported)[0][:, :, 0]

    def observed_jacobian(
        self, observation: Observation, p: np.ndarray, conditions: np.ndarray, reported: np.ndarray
    ) -> np.ndarray:
        """Return the derivatives of `observed_error`, shape (n_rows, n_units, n_parameters)."""
        return self.observed(
            "slope", lambda p, c, error: [ca.jacobian(error, p)], observation, p, conditions, reported
        )[0]

    def closure_cosine(self, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the loop's closure cosine of each row, shape (n_rows,); a pose can be closed where it is within ±1."""
        return self.figures("closure", lambda p, c, at: [at.closure], p, conditions)[0].ravel()

    def equilibrium_error(self, p: np.ndarray, conditions: np.ndarray) -> float:
        """Return how far [m] one more evaluation of the loads would move any row, at most."""

        def further(p: ca.SX, c: ca.SX, at: SymbolicPrediction) -> list[ca.SX]:
            return [self.expression(p, c, turns=EQUILIBRIUM_TURNS + 1).position - at.position]

        return float(np.linalg.norm(self.figures("further", further, p, conditions)[0], axis=1).max())

    def figures(self, name: str, of: Figures, p: np.ndarray, conditions: np.ndarray) -> list[np.ndarray]:
        """Return figures of rows (n_conditions, n_rows), each (n_rows, *shape).

        of gives their expressions for symbols of the parameters and of a row, and what is predicted; it is asked once for a name,
        which therefore says all that its closure holds.
        """
        key = name, of.__code__
        if key not in self.made:
            self.made[key] = _figures(name, self.symbols[:2], of(*self.symbols))
        return self._of_rows(self.made[key], p, conditions)

    def observed(
        self,
        name: str,
        of: Figures,
        observation: Observation,
        p: np.ndarray,
        conditions: np.ndarray,
        reported: np.ndarray,
    ) -> list[np.ndarray]:
        """Return figures of what an observation's error is at rows; of gives them for that in the place of what is predicted."""
        key = f"{name}{self.observations.index(observation)}", of.__code__
        if key not in self.made:
            (y, error), symbols = self.error(observation), self.symbols[:2]
            self.made[key] = _figures(key[0], (*symbols, y), of(*symbols, error))
        return self._of_rows(self.made[key], p, conditions, reported)

    def _of_rows(self, function: ca.Function, p: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
        values = enumerate(self.over_rows(function, p, *rows))
        return [value.T.reshape(rows[0].shape[1], *function.size_out(k)[::-1]) for k, value in values]

    def over_rows(self, function: ca.Function, p: np.ndarray, *rows: np.ndarray, passes: int = 1) -> list[np.ndarray]:
        """Evaluate a function of this model's graph as `over_rows` does, as machine code once that pays for so many rows.

        passes is how often these rows are expected to be evaluated.
        """
        self._evaluations[function] += rows[0].shape[1]
        expected = max(passes * rows[0].shape[1], self._evaluations[function] // 2)  # as often again as not
        made = self._compiled.get(function)
        if made is None or (expected >= WORTH_EVALUATIONS and made is function):
            made = self._compiled[function] = compiled(function, expected)
        return over_rows(made, p, *rows)

    @cached_property
    def made(self) -> dict[Hashable, ca.Function]:
        """Functions of this model's graph, by what makes each: to make one takes longer than a fit's few evaluations."""
        return {}

    @cached_property
    def _evaluations(self) -> Counter[ca.Function]:
        """How many rows each was evaluated for: nobody knows beforehand how many parts there will be."""
        return Counter()

    @cached_property
    def _compiled(self) -> dict[ca.Function, ca.Function]:
        """What has been looked up in the cache of compiled functions; the look-up takes longer than a few rows."""
        return {}


def _figures(name: str, inputs: Sequence[ca.SX], outputs: list[Any]) -> ca.Function:
    """The function of figures, each transposed, so that values of many rows follow each other as NumPy has them."""
    return ca.Function(name, inputs, [ca.densify(ca.SX(output)).T for output in outputs])


def build(
    robot: Robot,
    effects: Sequence[str | type[Effect] | Effect],
    given: tuple[str, ...] = (),
    observations: tuple[Observation, ...] = (),
) -> Model:
    """Return the model of a robot with the effects of these ids or classes, and with others as they are."""
    every = (
        replace(effect, robot=robot) if isinstance(effect, Effect) else _class(effect)(robot) for effect in effects
    )
    return Model(robot, tuple(every), given, observations)


def stated(
    robot: Robot,
    effects: Sequence[str | type[Effect] | Effect],
    data: Measurements,
    observations: tuple[Observation, ...] = (),
) -> Model:
    """Return the model of a robot with the effects of these ids or classes, in the forms that a study means for these rows."""
    forms = [effect if isinstance(effect, Effect) else _class(effect).stated(robot, data) for effect in effects]
    return build(robot, forms, data.given, observations)


def _class(effect: str | type[Effect]) -> type[Effect]:
    """The effect of an id, or itself.

    Raises:
        InputError: there is none.
    """
    if not isinstance(effect, str):
        return effect
    if kind := effect_class(effect):
        return kind
    raise refuse(f"unknown effect '{effect}'{nearest(effect, catalogue())}", key="effects")


def over_rows(function: ca.Function, p: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """Evaluate a function (p, row, ...) -> dense outputs over many rows, each (size, n_rows); outputs side by side."""
    n_rows = rows[0].shape[1]
    values = [np.empty((n_rows, function.numel_out(k))) for k in range(function.n_out())]
    if n_rows:
        _evaluate(function, p, [np.ascontiguousarray(row.T) for row in rows], values)
    return [value.reshape(n_rows * function.size2_out(k), function.size1_out(k)).T for k, value in enumerate(values)]


def _evaluate(function: ca.Function, p: np.ndarray, rows: Sequence[np.ndarray], values: Sequence[np.ndarray]) -> None:
    """Fill values, each (n_rows, size), from rows, likewise, in blocks of one size: the last overlaps the one before."""
    n_rows = len(values[0])
    per_row = max(map(function.numel_out, range(function.n_out())))
    most = max(1, min(BLOCK_ROWS, BLOCK_VALUES // max(1, per_row)))
    size = -(-n_rows // -(-n_rows // most))
    every, mapped = np.tile(np.asarray(p, dtype=float), size), _mapped(function, size)
    for start in [*range(0, n_rows - size, size), n_rows - size]:
        part = slice(start, start + size)
        fill(mapped, [every, *(row[part] for row in rows)], [value[part] for value in values])


def fill(function: ca.Function, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> None:
    """Evaluate a function of dense inputs in NumPy's own memory, without lists between; arrays are contiguous, columns first."""
    buffer, evaluate = function.buffer()
    for k, values in enumerate(inputs):
        buffer.set_arg(k, memoryview(values.reshape(-1)))  # type: ignore[call-arg, arg-type]
    for k, values in enumerate(outputs):
        buffer.set_res(k, memoryview(values.reshape(-1)))  # type: ignore[call-arg, arg-type]
    evaluate()


@lru_cache(maxsize=64)
def _mapped(function: ca.Function, n_rows: int) -> ca.Function:
    """The function over so many rows at once; building it takes longer than evaluating it."""
    return function.map(n_rows)
