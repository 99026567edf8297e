"""Probing: the Jacobian by the parameters of very many effects, through the few inner quantities of the graph.

An effect moves a residual through an inner quantity: a dimension, mass, torque, joint, bearing, link end, reported point or target
point. By the chain rule its derivative is that of the residual by the quantity (a lever) times that of the quantity by the effect's
parameter. Levers are few and belong to the model; the other factor is a function of a row's state alone, the same for every model.
CasADi supplies both, so that thousands of columns need one small graph and a product.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import ClassVar, TypeVar

import casadi as ca
import numpy as np

from calflow.effects import Effect
from calflow.estimation.least_squares import LeastSquares, SeriesBlock
from calflow.model import Asked, compiled, over_rows
from calflow.robot.mechanism import Deflection, Dimensions, Loads, Row, State, nominal_dimensions, nominal_loads
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

ROWS = 256  # rows whose columns are evaluated at once

Parts = TypeVar("Parts", bound=Dimensions | Loads | Deflection | State)


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

    @property
    def packed(self) -> ca.SX:
        """All quantities, stacked in one column."""
        points = ca.vertcat(self.reported, self.target)
        return ca.vertcat(_packed(self.dims), _packed(self.loads), self.torque, _packed(self.deflection), points)

    @staticmethod
    def unpacked(robot: Robot, column: ca.SX) -> Inner:
        """Return the quantities from a stacked column."""
        n = robot.n_joints
        shapes = (nominal_dimensions(robot), nominal_loads(robot), Deflection.zero(n))
        sizes = [_packed(shape).numel() for shape in shapes]
        ends = [0, *np.cumsum([*sizes[:2], n, sizes[2], 3, 3]).tolist()]
        dims, loads, torque, moves, *points = ca.vertsplit(column, ends)
        return Inner(_like(shapes[0], dims), _like(shapes[1], loads), torque, _like(shapes[2], moves), *points)

    @staticmethod
    def width(robot: Robot) -> int:
        """Return the length of the stacked column."""
        nothing, point = ca.SX(robot.n_joints, 1), ca.SX(3, 1)
        still = Deflection.zero(robot.n_joints)
        return int(Inner(nominal_dimensions(robot), nominal_loads(robot), nothing, still, point, point).packed.numel())


@dataclass(frozen=True)
class Levers(Effect):
    """An effect with one parameter per inner quantity, in the order of `Inner.packed`, which is added to that quantity."""

    id: ClassVar[str] = "levers"
    title: ClassVar[str] = "inner quantities"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return one parameter per quantity."""
        return tuple(Parameter(self.id, str(k), "", "1", 1.0, -1.0, 1.0) for k in range(Inner.width(self.robot)))

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Add to the dimensions."""
        return _sum(dims, Inner.unpacked(self.robot, p).dims)

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Add to the masses."""
        return _sum(loads, Inner.unpacked(self.robot, p).loads)

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Add to the torques."""
        return Inner.unpacked(self.robot, p).torque

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Move joints, bearings and link ends."""
        return Inner.unpacked(self.robot, p).deflection

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Add to the reported point."""
        return point + Inner.unpacked(self.robot, p).reported

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Move a target's point."""
        return point + Inner.unpacked(self.robot, p).target


@dataclass(frozen=True, eq=False)
class Basis:
    """Derivatives of the inner quantities by effects' parameters, at nominal values: the nonzeros, as a function of a row's state.

    quantity (n_slopes,) is the index of the quantity, column (n_slopes,) that of the parameter among those of all the effects.
    """

    function: ca.Function
    quantity: np.ndarray
    column: np.ndarray

    @property
    def layers(self) -> Iterator[np.ndarray]:
        """Yield layers of indices of slopes, such that no parameter occurs twice in a layer."""
        order = np.argsort(self.column, kind="stable")
        first = np.searchsorted(self.column[order], self.column[order])
        depth = np.arange(len(order)) - first
        yield from (order[depth == k] for k in range(int(depth.max(initial=-1)) + 1))


@dataclass(frozen=True, eq=False)
class Probe:
    """A problem at p, with additional effects at nominal values: residuals and Jacobian of any of its rows.

    graphs: function of a row for each of the problem's blocks; bases: derivatives of the inner quantities by the effects'
    parameters, empty where an observation does not report a single point, the graphs then holding all derivatives; width: number
    of the effects' parameters.
    """

    problem: LeastSquares
    p: np.ndarray
    graphs: tuple[ca.Function, ...]
    bases: tuple[Basis, ...]
    width: int

    @staticmethod
    def of(problem: LeastSquares, p: np.ndarray, effects: Sequence[Effect]) -> Probe:
        """Return the probe of a problem at p, with graphs built once per model."""
        model = problem.model
        if not effects:  # the graphs of the fit serve
            return Probe(problem, p, tuple(block.graph for block in problem.blocks), (), 0)
        bases, width = _bases(effects, model.given)
        moved = problem.on(replace(model, probes=(Levers(model.robot),)))
        pairs = zip(problem.blocks, moved.blocks, strict=True)
        graphs = tuple(graph for block, with_levers in pairs if (graph := _graph(block, with_levers)))
        if len(graphs) == len(problem.blocks):
            return Probe(problem, np.append(p, np.zeros(Inner.width(model.robot))), graphs, tuple(bases), width)
        large = replace(model, probes=tuple(effects))
        graphs = tuple(block.graph for block in problem.on(large).blocks)
        return Probe(problem, np.append(p, large.nominal[len(p) :]), graphs, (), width)

    def compiled(self, passes: int) -> Probe:
        """Return the same with graphs compiled, where that pays for the given number of passes over all rows."""
        evaluations = passes * self.problem.n_rows
        graphs = tuple(compiled(graph, evaluations) for graph in self.graphs)
        bases = tuple(replace(basis, function=compiled(basis.function, evaluations)) for basis in self.bases)
        return replace(self, graphs=graphs, bases=bases)

    @property
    def n_parameters(self) -> int:
        """Number of the model's parameters, without those of the effects."""
        return len(self.problem.model.parameters)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the Jacobian, whose columns are the model's parameters, then those of the effects."""
        return self.problem.size, self.n_parameters + self.width

    def parts(self) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Yield, for some hundred residuals at a time, their slice, and the decorrelated residuals and Jacobian."""
        for block, part, residuals, left, slopes in self._evaluated():
            yield residuals, block.decorrelated(left, part), block.decorrelated(slopes, part)

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the whitened residuals (n,) and the Jacobian of all rows."""
        residual, matrix = np.empty(self.problem.size), np.empty(self.shape)
        for _, _, residuals, left, slopes in self._evaluated():
            residual[residuals], matrix[residuals] = left, slopes
        return residual, matrix

    def _evaluated(self) -> Iterator[tuple[SeriesBlock, slice, slice, np.ndarray, np.ndarray]]:
        """Yield block, slice of its rows, slice of the residuals, and these whitened residuals and Jacobian."""
        start, n = 0, self.n_parameters
        for block, graph in zip(self.problem.blocks, self.graphs, strict=True):
            for part in block.parts(size=ROWS):
                data = [values[:, part] for values in block.data]
                left, slopes, *state = over_rows(graph, self.p, *data)
                slopes = slopes.T.reshape(left.shape[1], block.n_units, -1)
                if self.bases:
                    levers = slopes[..., n:]
                    slopes = np.concatenate([slopes[..., :n], np.zeros((*slopes.shape[:2], self.width))], axis=2)
                    _fill(slopes[..., n:], self.bases, levers, state[0], data[0])
                residuals = slice(start + part.start * block.n_units, start + part.stop * block.n_units)
                yield block, part, residuals, left.T.ravel(), slopes.reshape(-1, self.shape[1])
            start += len(block.rows) * block.n_units


def probed(problem: LeastSquares, p: np.ndarray, effects: Sequence[Effect]) -> tuple[np.ndarray, np.ndarray]:
    """Return the stacked whitened residuals (n,) at p, and their Jacobian (n, n_parameters + n_columns).

    Its columns are the model's parameters, then those of the additional effects, at nominal values.
    """
    return Probe.of(problem, p, effects).whole()


def _fill(
    columns: np.ndarray, bases: Sequence[Basis], levers: np.ndarray, state: np.ndarray, conditions: np.ndarray
) -> None:
    """Add the products of levers (n_rows, n_units, n_quantities) and bases to columns (n_rows, n_units, n_columns)."""
    for basis in bases:
        slopes = over_rows(basis.function, np.zeros(0), state, conditions)[0].T
        for layer in basis.layers:
            moved = np.take(levers, basis.quantity[layer], axis=2)
            moved *= slopes[:, None, side_by_side(layer)]
            columns[:, :, side_by_side(basis.column[layer])] += moved


def side_by_side(numbers: np.ndarray) -> np.ndarray | slice:
    """Return increasing indices (n,) as a slice where they are consecutive, so that NumPy indexes without a copy."""
    first, last = int(numbers[0]), int(numbers[-1])
    return slice(first, last + 1) if last - first == len(numbers) - 1 else numbers


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
    """Return the function of a row: whitened residual, its Jacobian by parameters and levers, transposed, and the row's state.

    It is built once per model; moved is the same block of the model with levers. None where an observation depends on several
    points.
    """
    key, made = f"levers {block.key}", block.model.made
    if key not in made and (function := _with_levers(moved)):
        made[key] = function
    return made.get(key)


def _with_levers(block: SeriesBlock) -> ca.Function | None:
    asked = Asked([], [])
    inputs, residual = block.expression(asked)
    if max(map(len, asked)) > 1:
        return None
    p, _, predicted = block.model.symbols
    state = ca.vertcat(
        *(_packed(predicted.dims), _packed(predicted.loads), _packed(predicted.state)),
        *(points[0] if points else ca.SX(3, 1) for points in asked),
    )
    residual, state = ca.cse([residual, state])  # a third of the operations are duplicates
    outputs = [residual, ca.jacobian(residual, p).T, state]
    (probe,) = block.model.probes
    levers = p[block.model.columns(probe).tolist()]
    outputs = ca.substitute(outputs, [levers], [ca.SX.zeros(levers.numel())])
    return ca.Function("levers", inputs, [ca.densify(output) for output in outputs])


@lru_cache(maxsize=256)
def _basis(effects: tuple[Effect, ...], given: tuple[str, ...]) -> Basis:
    """Return the derivatives of the inner quantities by the parameters of effects, at nominal values."""
    robot = effects[0].robot
    n = robot.n_joints
    shapes = (nominal_dimensions(robot), nominal_loads(robot), State.symbols(robot))
    sizes = [_packed(shape).numel() for shape in shapes]
    symbols = ca.SX.sym("state", sum(sizes) + 6)
    c = ca.SX.sym("c", sum(Row.sizes(robot, given).values()))
    ends = [0, *np.cumsum([*sizes, 3, 3]).tolist()]
    *parts, point, seen_target = ca.vertsplit(symbols, ends)
    dims, loads, state = _like(shapes[0], parts[0]), _like(shapes[1], parts[1]), _like(shapes[2], parts[2])
    row, still = Row.unpack(robot, c, given), Deflection.zero(n)
    moved = Inner(dims, loads, ca.SX(n, 1), still, point, seen_target)
    start = np.cumsum([0, *(len(effect.declared) for effect in effects)])
    every = ca.SX.sym("p", int(start[-1]))
    for effect, p in zip(effects, ca.vertsplit(every, start.tolist()), strict=True):
        torque = effect.torque(p, state, row)
        report, there = effect.device(p, point, row), effect.target(p, seen_target, row)
        moved = Inner(
            _with_change(moved.dims, effect.dimensions(p, dims, row), dims),
            _with_change(moved.loads, effect.loads(p, loads, row), loads),
            moved.torque + torque if isinstance(torque, ca.SX) else moved.torque,
            _with_change(moved.deflection, effect.deflection(p, state, row, still), still),
            moved.reported if report is point else moved.reported + (report - point),
            moved.target if there is seen_target else moved.target + (there - seen_target),
        )
    nominal = ca.SX(ca.DM([parameter.nominal for effect in effects for parameter in effect.declared]))
    slope = ca.sparsify(ca.substitute(ca.jacobian(moved.packed, every), every, nominal))
    quantity, column = (np.array(which, dtype=int) for which in slope.sparsity().get_triplet())
    function = ca.Function("basis", [ca.SX.sym("p", 0), symbols, c], [ca.densify(slope.nz[:])])
    return Basis(function, quantity, column)


def _with_change(parts: Parts, after: Parts, before: Parts) -> Parts:
    """Return parts plus the change from before to after, field by field; most effects change few fields."""
    if after is before:
        return parts
    changed = {field.name: getattr(parts, field.name) + getattr(after, field.name) - getattr(before, field.name)
               for field in fields(parts) if getattr(after, field.name) is not getattr(before, field.name)}  # fmt: skip
    return replace(parts, **changed)


def _packed(parts: Parts) -> ca.SX:
    return ca.densify(ca.vertcat(*(ca.vec(getattr(parts, field.name)) for field in fields(parts))))


def _like(shape: Parts, column: ca.SX) -> Parts:
    """Return the object with the fields and sizes of shape from a stacked column."""
    sizes = [getattr(shape, field.name).shape for field in fields(shape)]
    columns = ca.vertsplit(column, [0, *np.cumsum([rows * columns for rows, columns in sizes]).tolist()])
    return replace(
        shape,
        **{
            field.name: ca.reshape(part, *size) for field, part, size in zip(fields(shape), columns, sizes, strict=True)
        },  # type: ignore[arg-type]
    )


def _sum(first: Parts, other: Parts) -> Parts:
    return replace(
        first, **{part.name: getattr(first, part.name) + getattr(other, part.name) for part in fields(first)}
    )
