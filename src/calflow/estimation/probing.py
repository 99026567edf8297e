"""Probing: the Jacobian by the parameters of very many effects, through the few inner quantities of the graph.

An effect moves a residual through an inner quantity: a dimension, mass, torque, joint, bearing, link end, reported point or target
point. By the chain rule its derivative is that of the residual by the quantity (a lever) times that of the quantity by the effect's
parameter. Levers are few and belong to the model; the other factor is a function of a row's state alone, the same for every model.
CasADi supplies both, so that thousands of columns need one small graph and a product.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, TypeVar

import casadi as ca
import numpy as np

from calflow.effects import Effect
from calflow.estimation.least_squares import LeastSquares, SeriesBlock
from calflow.model import Asked, compiled, over_rows, side_by_side
from calflow.robot.mechanism import Deflection, Dimensions, Loads, Row, State, nominal_dimensions, nominal_loads
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

ROWS = 128  # rows whose columns are evaluated at once

Parts = TypeVar("Parts")  # a quantity, or a data class or tuple of such


@dataclass(frozen=True)
class Inner:
    """The quantities through which an effect can act, as numbers or as expressions.

    reported is the point that the device reports, target a point in the target's frame, (3,) [m] each.
    """

    dims: Dimensions
    loads: Loads
    torque: ca.SX
    deflection: Deflection
    reported: ca.SX
    target: ca.SX

    @staticmethod
    def still(robot: Robot) -> Inner:
        """Return the nominal quantities without loads, the points at zero."""
        n = robot.n_joints
        dims, loads = nominal_dimensions(robot), nominal_loads(robot)
        return Inner(dims, loads, ca.SX(n, 1), Deflection.zero(n), ca.SX(3, 1), ca.SX(3, 1))


@dataclass(frozen=True)
class Levers(Effect):
    """An effect with one parameter per inner quantity, in the order in which they are packed, which is added to it."""

    id: ClassVar[str] = "levers"
    title: ClassVar[str] = "inner quantities"

    def _added(self, p: ca.SX) -> Inner:
        return _unpacked(Inner.still(self.robot), p)

    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(self.id, str(k), "", "1", 1.0, -1.0, 1.0) for k in range(_width(Inner.still(self.robot)))
        )

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        return _unpacked(dims, stacked(dims) + stacked(self._added(p).dims))

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        return _unpacked(loads, stacked(loads) + stacked(self._added(p).loads))

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        return self._added(p).torque

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        return self._added(p).deflection

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        return point + self._added(p).reported

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        return point + self._added(p).target


@dataclass(frozen=True, eq=False)
class Basis:
    """Derivatives of the inner quantities by effects' parameters, at nominal values: the nonzeros, as a function of a row's state.

    quantity (n_slopes,) is the index of the quantity, column (n_slopes,), in order, that of the parameter among those of all
    the effects.
    """

    function: ca.Function
    quantity: np.ndarray
    column: np.ndarray

    @cached_property
    def first(self) -> np.ndarray:
        """The index of each parameter's first slope."""
        return np.flatnonzero(np.diff(self.column, prepend=-1))

    @cached_property
    def columns(self) -> np.ndarray | slice:
        """The parameters' columns."""
        return side_by_side(self.column[self.first])


@dataclass(frozen=True, eq=False)
class Probe:
    """A problem at p, with additional effects at nominal values: residuals and Jacobian of any of its rows.

    n_parameters: the problem's, whose columns come first; graphs: of each block, derivatives by the inner quantities and a row's
    state; bases: of these quantities by the effects' parameters, empty, as graphs, where an observation does not report a single
    point: the problem's model then has the effects; width: number of their parameters; foreign: of each block, the columns of
    effects that its device does not have.
    """

    problem: LeastSquares
    p: np.ndarray
    n_parameters: int
    graphs: tuple[ca.Function, ...]
    bases: tuple[Basis, ...]
    width: int
    foreign: tuple[np.ndarray, ...]

    @staticmethod
    def of(problem: LeastSquares, p: np.ndarray, effects: Sequence[Effect]) -> Probe:
        """Return the probe of a problem at p, with graphs built once per model."""
        model, n = problem.model, len(p)
        foreign = tuple(_foreign(effects, block.observation.series.device) for block in problem.blocks)
        if not effects:
            return Probe(problem, p, n, (), (), 0, foreign)
        bases, width = _bases(effects, model.given)
        moved = problem.on(replace(model, probes=(Levers(model.robot),)))
        graphs = tuple(filter(None, map(_graph, problem.blocks, moved.blocks)))
        if len(graphs) == len(problem.blocks):
            return Probe(problem, p, n, graphs, tuple(bases), width, foreign)
        large = replace(model, probes=tuple(effects))
        return Probe(problem.on(large), np.append(p, large.nominal[n:]), n, (), (), width, foreign)

    def compiled(self, passes: int) -> Probe:
        """Return the same with graphs compiled, where that pays for the given number of passes over all rows."""
        evaluations = passes * self.problem.n_rows
        graphs = tuple(compiled(graph, evaluations) for graph in self.graphs)
        bases = tuple(replace(basis, function=compiled(basis.function, evaluations)) for basis in self.bases)
        return replace(self, graphs=graphs, bases=bases)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the Jacobian, whose columns are the model's parameters, then those of the effects."""
        return self.problem.size, self.n_parameters + self.width

    def parts(self) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Yield, for some hundred residuals at a time, their slice, and the decorrelated residuals and Jacobian."""
        start, n = 0, self.n_parameters
        for k, block in enumerate(self.problem.blocks):
            for part in block.parts(size=ROWS):
                left, slopes = part.linearised(self.p)
                if self.bases:
                    levers, state = over_rows(self.graphs[k], self.p, *part.data)
                    levers = levers.T.reshape(*left.shape, -1)
                    slopes = np.concatenate([slopes, np.zeros((*left.shape, self.width))], axis=2)
                    for basis in self.bases:
                        moved = np.take(levers, basis.quantity, axis=2)
                        moved *= over_rows(basis.function, np.zeros(0), state, part.conditions)[0].T[:, None]
                        if len(basis.first) < len(basis.column):  # else the sums are of one each
                            moved = np.add.reduceat(moved, basis.first, axis=2)
                        slopes[:, :, n:][:, :, basis.columns] = moved
                    slopes[:, :, n + self.foreign[k]] = 0.0
                rows, start = slice(start, start + left.size), start + left.size
                yield rows, part.decorrelated(left).ravel(), part.decorrelated(slopes).reshape(-1, self.shape[1])

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the decorrelated residuals (n,) and the Jacobian of all rows."""
        residual, matrix = np.empty(self.problem.size), np.empty(self.shape)
        for rows, left, slopes in self.parts():
            residual[rows], matrix[rows] = left, slopes
        return residual, matrix


def probed(problem: LeastSquares, p: np.ndarray, effects: Sequence[Effect]) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals (n,) at p, decorrelated, and the Jacobian by the model's parameters, then the effects'."""
    return Probe.of(problem, p, effects).whole()


def _foreign(effects: Sequence[Effect], device: str) -> np.ndarray:
    return np.flatnonzero(
        np.repeat([not each.concerns(device) for each in effects], [len(each.declared) for each in effects])
    )


def _bases(effects: Sequence[Effect], given: tuple[str, ...]) -> tuple[list[Basis], int]:
    """Return the bases of all effects, one per kind, with columns in the order of the effects, and the number of columns."""
    start = np.cumsum([0, *(len(effect.declared) for effect in effects)])
    kinds: dict[tuple[type[Effect], str], list[int]] = {}
    for k, effect in enumerate(effects):
        kinds.setdefault((type(effect), effect.id), []).append(k)
    runs = []
    for members in kinds.values():
        basis = _basis(tuple(effects[k] for k in members), given)
        columns = np.concatenate([np.arange(start[k], start[k + 1]) for k in members])
        runs.append(replace(basis, column=columns[basis.column]))
    return runs, int(start[-1])


def _graph(block: SeriesBlock, moved: SeriesBlock) -> ca.Function | None:
    """Return the function of a row: Jacobian of the whitened residual by levers, transposed, and the row's state.

    It is built once per model; moved is the same block of the model with levers. None where an observation depends on several
    points.
    """
    key, made = f"levers {block.key}", block.model.graph.made
    if key in made:
        return made[key]
    asked = Asked([], [])
    inputs, residual = moved.expression(asked)
    if max(map(len, asked)) > 1:
        return None
    p, _, predicted = moved.model.symbols
    points = (seen[0] if seen else ca.SX(3, 1) for seen in asked)
    state = stacked((predicted.dims, predicted.loads, predicted.state, *points))
    residual, state = ca.cse([residual, state])  # a third of the operations are duplicates
    (probe,) = moved.model.probes
    levers, own = p[moved.model.columns(probe).tolist()], block.model.symbols[0]
    outputs = [ca.jacobian(residual, levers).T, state]
    outputs = ca.substitute(outputs, [p], [ca.vertcat(own, ca.SX.zeros(levers.numel()))])
    made[key] = ca.Function("levers", [own, *inputs[1:]], [ca.densify(output) for output in outputs])
    return made[key]


@lru_cache(maxsize=256)
def _basis(effects: tuple[Effect, ...], given: tuple[str, ...]) -> Basis:
    """Return the derivatives of the inner quantities by the parameters of effects, at nominal values."""
    robot = effects[0].robot
    still = Inner.still(robot)
    shape = (still.dims, still.loads, State.symbols(robot), still.reported, still.target)
    symbols = ca.SX.sym("state", _width(shape))
    c = ca.SX.sym("c", sum(Row.sizes(robot, given).values()))
    dims, loads, state, point, target = _unpacked(shape, symbols)
    row, before = Row.unpack(robot, c, given), (dims, loads, still.torque, still.deflection, point, target)
    moved = [ca.SX(_width(quantity), 1) for quantity in before]
    start = np.cumsum([0, *(len(effect.declared) for effect in effects)])
    every = ca.SX.sym("p", int(start[-1]))
    for effect, own in zip(effects, ca.vertsplit(every, start.tolist()), strict=True):
        acting, p = effect.acts_as(own, row)
        torque = acting.torque(p, state, row)
        after = (
            acting.dimensions(p, dims, row),
            acting.loads(p, loads, row),
            torque if isinstance(torque, ca.SX) else still.torque,
            acting.deflection(p, state, row, still.deflection),
            acting.device(p, point, row),
            acting.target(p, target, row),
        )
        for k, (now, earlier) in enumerate(zip(after, before, strict=True)):
            if now is not earlier:
                moved[k] += _change(now, earlier)
    nominal = ca.SX(ca.DM([parameter.nominal for effect in effects for parameter in effect.declared]))
    slope = ca.sparsify(ca.substitute(ca.jacobian(ca.vertcat(*moved), every), every, nominal))
    quantity, column = (np.array(which, dtype=int) for which in slope.sparsity().get_triplet())
    function = ca.Function("basis", [ca.SX.sym("p", 0), symbols, c], [ca.densify(slope.nz[:])])
    return Basis(function, quantity, column)


def _members(parts: Any) -> list[Any]:
    return list(parts) if isinstance(parts, tuple) else [getattr(parts, field.name) for field in fields(parts)]


def stacked(parts: Any) -> ca.SX:
    """Return all quantities of parts, stacked in one column."""
    return ca.densify(ca.vec(parts)) if isinstance(parts, ca.SX) else ca.vertcat(*map(stacked, _members(parts)))


def _width(parts: Any) -> int:
    return int(parts.numel()) if isinstance(parts, ca.SX) else sum(map(_width, _members(parts)))


def _change(after: Any, before: Any) -> ca.SX:
    """Return the change of all quantities, stacked; most effects leave most of them as they are."""
    if after is before:
        return ca.SX(_width(before), 1)
    if isinstance(before, ca.SX):
        return ca.vec(after - before)
    return ca.vertcat(*map(_change, _members(after), _members(before)))


def _unpacked(shape: Parts, column: ca.SX) -> Parts:
    if isinstance(shape, ca.SX):
        return ca.reshape(column, *shape.shape)  # type: ignore[return-value]
    members = _members(shape)
    ends = np.cumsum([0, *map(_width, members)]).tolist()
    parts = map(_unpacked, members, ca.vertsplit(column, ends))
    return type(shape)(parts) if isinstance(shape, tuple) else type(shape)(*parts)
