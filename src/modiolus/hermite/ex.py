"""EX files, the exchange format of Zinc and CMGUI: what they hold, and writing them.

A field is defined at nodes, by values and derivatives of which a node may have several versions,
and in elements, by the node's parameter that every basis function takes and the scale factors
that multiply it. These are the entries of the extraction operator. `write_ex` writes version 2
(``.exf``, for Zinc and everything built upon it) or the older pair ``.exnode`` and ``.exelem`` that
every CMGUI reads; `modiolus.hermite.exread.read_ex` reads these and version 3.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .basis import Array, IntArray, basis
from .check import numbers, whole
from .mesh import HermiteMesh

__all__ = ["LABELS", "ExField", "ExMesh", "write_ex"]

#: Names of a node's value and derivatives, in the order of the basis.
LABELS = (
    *("value", "d/ds1", "d/ds2", "d2/ds1ds2"),
    *("d/ds3", "d2/ds1ds3", "d2/ds2ds3", "d3/ds1ds2ds3"),
)
#: Field of the position at rest.
COORDINATES = "coordinates"
#: Field of the fibres' Euler angles in radians.
FIBRES = "fibres"

_SHAPES = ("", "line", "line*line", "line*line*line")


@dataclass(frozen=True, eq=False)
class ExField:
    """A field of an EX file on the elements of its mesh.

    Attributes
    ----------
    name : str
    parameters : (n_params, components) array
        The nodes' values and derivatives.
    extraction : CSR matrix (n_elements * 4**dim, n_params)
        Local cubic Hermite parameters = ``extraction @ parameters``; Lagrange elements up to
        cubic ones are represented exactly.
    defined : (n_elements,) bool array
        Where the field is defined.
    """

    name: str
    parameters: Array
    extraction: sp.csr_matrix
    defined: NDArray[np.bool_]

    def evaluate(self, elements: ArrayLike, xi: ArrayLike) -> Array:
        """Evaluate the field at points of elements, (n, components); NaN where undefined."""
        elements = whole("elements", elements, len(self.defined))
        size = self.extraction.shape[0] // len(self.defined)
        dim = (size.bit_length() - 1) // 2
        local = np.asarray(self.extraction @ self.parameters).reshape(-1, size, self.n_components)
        out = np.einsum("na,nac->nc", basis(dim, xi), local[elements])
        out[~self.defined[elements]] = np.nan
        return np.asarray(out)

    @property
    def n_components(self) -> int:
        """Number of components."""
        return int(self.parameters.shape[1])


@dataclass(frozen=True, eq=False)
class ExMesh:
    """What an EX file holds.

    Attributes
    ----------
    mesh : HermiteMesh
        The elements of highest dimension that have coordinates.
    fields : dict of ExField
        The other fields that are defined in these elements, by name. One that is interpolated
        like the coordinates has parameters that `HermiteMesh.with_parameters` takes.
    groups : dict of (n,) int array
        Elements of each group that has any, as indices.
    identifiers : (n_elements,) int array
        Numbers of the elements in the file.
    """

    mesh: HermiteMesh
    fields: dict[str, ExField]
    groups: dict[str, IntArray]
    identifiers: IntArray


def write_ex(
    path: str | Path,
    mesh: HermiteMesh,
    fields: Mapping[str, Array] | None = None,
    linear: Mapping[str, Array] | None = None,
    groups: Mapping[str, ArrayLike] | None = None,
    first: tuple[int, int] = (1, 1),
) -> tuple[int, int]:
    """Write a mesh with its fields.

    Every corner of the mesh becomes a node. Where elements use different parameters of a node, as
    at the end of a slit, these are its versions; factors in the extraction are scale factors.
    Rows of the extraction that combine parameters are written as parameters of their own.

    Parameters
    ----------
    path : path
        ``name.exf``; or ``name.exnode`` or ``name.exelem``, of which both are written.
    mesh : HermiteMesh
        Its position is the field ``coordinates``.
    fields : mapping of str to (n_params, components) array, optional
        Parameters of other fields in the same space.
    linear : mapping of str to (n_elements, 2**dim, components) array, optional
        Values at the corners of fields that are interpolated linearly in each direction. The
        field ``fibres`` is marked as the Euler angles of fibres.
    groups : mapping of str to int array, optional
        Elements by the name of their group.
    first : (int, int)
        Number of the first node and of the first element.

    Returns
    -------
    tuple of int
        The first number of a node and of an element that are free.

    Raises
    ------
    InputError
        The path ends otherwise, an array does not fit the mesh or is not finite, or a name cannot
        stand in the file.
    OSError
        A file cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".exf", ".exnode", ".exelem"):
        raise InputError(f"{path}: no name of an EX file; let it end in .exf or .exnode")
    fields, linear, groups = fields or {}, linear or {}, groups or {}
    for name in [*fields, *linear, *groups]:
        if not name.isprintable() or not name.strip() or name != name.strip() or "," in name:
            raise InputError(f"{name!r}: no name for an EX file; give words without commas")
    for name in [*fields, *linear]:
        if name == COORDINATES or (name in fields and name in linear):
            raise InputError(f"{name}: the name of another field; choose another")
    if min(first) < 1:
        raise InputError(f"first: numbers {first}; count from 1")
    fields = {name: numbers(name, v, mesh.n_params, None) for name, v in fields.items()}
    linear = {
        name: numbers(name, v, mesh.n_elements, 2**mesh.dim, None) for name, v in linear.items()
    }
    plan = _Plan.of(mesh, fields, linear, first)
    chosen = {name: np.unique(whole(name, e, mesh.n_elements)) for name, e in groups.items()}
    if path.suffix == ".exf":
        _write(path, _exf(plan, chosen))
    else:
        _write(path.with_suffix(".exnode"), _exnode(plan, chosen))
        _write(path.with_suffix(".exelem"), _exelem(plan, chosen))
    return first[0] + len(plan.layouts), first[1] + len(plan.corners)


def _write(path: Path, lines: Iterator[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(line + "\n" for line in lines)


#: A node's parameter: derivative and version, both from 0.
_Key = tuple[int, int]


@dataclass(frozen=True)
class _Plan:
    """Nodes, versions and scale factors of a mesh, before any syntax.

    Attributes
    ----------
    dim : int
    corners : (n_elements, 2**dim) int array
        Node of every corner, from 0.
    layouts : list of tuple of (derivative, version)
        The parameters of every node in the order of the file.
    columns : list of list of int
        The parameters' numbers.
    keys : list of tuple of (derivative, version) or None
        What the functions of every element take; None where nothing.
    scales : (n_elements, 4**dim) array
    fields : dict of (n_params, components) array
        The coordinates first.
    linear : dict of (n_nodes, components) array
    first : (int, int)
    """

    dim: int
    corners: IntArray
    layouts: list[tuple[_Key, ...]]
    columns: list[list[int]]
    keys: list[tuple[_Key | None, ...]]
    scales: Array
    fields: dict[str, Array]
    linear: dict[str, Array]
    first: tuple[int, int]

    @classmethod
    def of(
        cls,
        mesh: HermiteMesh,
        fields: Mapping[str, Array],
        linear: Mapping[str, Array],
        first: tuple[int, int],
    ) -> _Plan:
        dim, kinds = mesh.dim, 2**mesh.dim
        # Refined by 1 every local parameter is a multiple of one parameter, of one node.
        plain = mesh.refine((1,) * dim)
        corners, founders = plain.corner_nodes()
        if (corners < 0).any():
            raise InputError("mesh: a corner's position depends on no parameter; mend its operator")
        pattern = plain.extraction
        filled = np.diff(pattern.indptr) > 0
        column = np.full(len(filled), -1, dtype=np.int64)
        scales = np.zeros(len(filled))
        column[filled], scales[filled] = pattern.indices, pattern.data
        key_of: dict[int, _Key] = {}
        nodes: list[dict[_Key, int]] = [{} for _ in founders]
        for row in np.flatnonzero(filled).tolist():
            parameter = int(column[row])
            if parameter not in key_of:
                node = nodes[corners.ravel()[row // kinds]]
                kind = row % kinds
                key = (kind, sum(k == kind for k, _ in node))
                key_of[parameter] = key
                node[key] = parameter
        layouts = [tuple(sorted(node)) for node in nodes]
        # A parameter is known by one functional, which the old mesh tells for other fields.
        founding = np.zeros(plain.n_params, dtype=np.int64)
        rows = np.flatnonzero(filled)[::-1]
        founding[column[rows]] = rows
        read = sp.diags_array(1.0 / scales[founding]) @ mesh.extraction[founding]
        return cls(
            dim=dim,
            corners=corners,
            layouts=layouts,
            columns=[
                [node[key] for key in layout] for node, layout in zip(nodes, layouts, strict=True)
            ],
            keys=[
                tuple(key_of[c] if c >= 0 else None for c in element)
                for element in column.reshape(-1, 4**dim).tolist()
            ],
            scales=scales.reshape(-1, 4**dim),
            fields={
                COORDINATES: plain.parameters,
                **{name: np.asarray(read @ values) for name, values in fields.items()},
            },
            linear={
                name: values[founders[:, 0], founders[:, 1]] for name, values in linear.items()
            },
            first=first,
        )

    def node(self, index: int) -> int:
        return self.first[0] + index

    def element(self, index: int) -> int:
        return self.first[1] + index

    def members(self, elements: IntArray) -> tuple[list[int], list[int]]:
        """Return numbers of the nodes and the elements of a group."""
        nodes = np.unique(self.corners[elements])
        return [self.node(n) for n in nodes.tolist()], [self.element(e) for e in elements.tolist()]

    def values(self, node: int) -> Iterator[tuple[Array, bool]]:
        """Yield (parameters, components) of every field at a node, and whether it is linear."""
        for parameters in self.fields.values():
            yield parameters[self.columns[node]], False
        for values in self.linear.values():
            yield values[[node]], True


def _names(name: str, count: int) -> tuple[str, list[str]]:
    """Return what a field is, and what its components are called."""
    if name == COORDINATES:
        return "coordinate, rectangular cartesian", ["x", "y", "z"]
    if name == FIBRES:
        angles = ["fibre angle", "imbrication angle", "sheet angle"]
        return "anatomical, fibre", angles[:count]
    letters = ["x", "y", "z"] if count == 3 else [str(i + 1) for i in range(count)]
    return "field, rectangular cartesian", letters


def _declared(plan: _Plan) -> Iterator[tuple[str, list[str], bool]]:
    """Yield the line that declares each field, its components, and whether it is linear."""
    together = [*plan.fields.items(), *plan.linear.items()]
    for number, (name, values) in enumerate(together, start=1):
        kind, components = _names(name, values.shape[1])
        line = f"{number}) {name}, {kind}, real, #Components={len(components)}"
        yield line, components, number > len(plan.fields)


def _numbers(values: Iterable[float]) -> str:
    # The shortest digits that give the same number back.
    return " ".join(repr(float(value)) for value in values)


def _exf(plan: _Plan, groups: Mapping[str, IntArray]) -> Iterator[str]:
    yield "EX Version: 2"
    yield "Region: /"
    yield "!#nodeset nodes"
    before = None
    for node, layout in enumerate(plan.layouts):
        if layout != before:
            before = layout
            yield "Shape. Dimension=0"
            yield f"#Fields={len(plan.fields) + len(plan.linear)}"
            for line, components, is_linear in _declared(plan):
                yield line
                counts = {kind: 1 + max(v for k, v in layout if k == kind) for kind, _ in layout}
                labels = [LABELS[k] + (f"({n})" if n > 1 else "") for k, n in counts.items()]
                size = 1 if is_linear else len(layout)
                inside = "value" if is_linear else ",".join(labels)
                yield from (f" {c}. #Values={size} ({inside})" for c in components)
        yield f"Node: {plan.node(node)}"
        for values, _ in plan.values(node):
            yield from (f" {_numbers(component)}" for component in values.T)
    yield from _mesh_line(plan)
    last: object = None
    for element, keys in enumerate(plan.keys):
        scaled = (plan.scales[element] != 1.0) & np.array([key is not None for key in keys])
        pattern = (keys, scaled.tobytes())
        if pattern != last:
            last = pattern
            yield from _exf_template(plan, keys, scaled)
        yield f"Element: {plan.element(element)}"
        yield " Nodes:"
        yield " " + " ".join(str(plan.node(n)) for n in plan.corners[element].tolist())
        if scaled.any():
            yield " Scale factors:"
            yield f" {_numbers(plan.scales[element][scaled])}"
    for name, elements in groups.items():
        nodes, numbers = plan.members(elements)
        yield f"Group name: {name}"
        yield "!#nodeset nodes"
        yield from ("Shape. Dimension=0", "#Fields=0")
        yield from (f"Node: {n}" for n in nodes)
        yield from _mesh_line(plan)
        yield f"Shape. Dimension={plan.dim}, {_SHAPES[plan.dim]}"
        yield from ("#Scale factor sets=0", "#Nodes=0", "#Fields=0")
        yield from (f"Element: {n}" for n in numbers)


def _mesh_line(plan: _Plan) -> Iterator[str]:
    below = f", face mesh=mesh{plan.dim - 1}d" if plan.dim > 1 else ""
    yield f"!#mesh mesh{plan.dim}d, dimension={plan.dim}{below}, nodeset=nodes"


def _exf_template(
    plan: _Plan, keys: tuple[_Key | None, ...], scaled: NDArray[np.bool_]
) -> Iterator[str]:
    yield f"Shape. Dimension={plan.dim}, {_SHAPES[plan.dim]}"
    count = int(scaled.sum())
    yield f"#Scale factor sets={int(count > 0)}"
    if count:
        zeros = ",".join(["0"] * count)
        yield f'  scaling1, #Scale factors={count}, identifiers="element_general({zeros})"'
    yield f"#Nodes={2**plan.dim}"
    yield f"#Fields={len(plan.fields) + len(plan.linear)}"
    numbers = np.where(scaled, np.cumsum(scaled), 0).tolist()
    kinds = 2**plan.dim
    for line, components, is_linear in _declared(plan):
        yield line
        for component in components:
            yield from _basis_line(plan, component, is_linear, "scaling1" if count else "")
            for corner in range(kinds):
                if is_linear:
                    yield from (f"  {corner + 1}. #Values=1", "   Value labels: value")
                    continue
                place = slice(corner * kinds, (corner + 1) * kinds)
                for some, factors in _runs(keys[place], numbers[place]):
                    labels = [_label(key) for key in some]
                    node = corner + 1 if some[0] is not None else 0
                    yield f"  {node}. #Values={len(some)}"
                    yield f"   Value labels: {' '.join(labels)}"
                    if count and node:
                        yield f"   Scale factor indices: {' '.join(map(str, factors))}"


def _label(key: _Key | None) -> str:
    if key is None:
        return "zero"
    return LABELS[key[0]] + (f"({key[1] + 1})" if key[1] else "")


def _runs(
    keys: tuple[_Key | None, ...], numbers: list[int]
) -> Iterator[tuple[list[_Key | None], list[int]]]:
    """Split functions of a corner where those that take something and those that do not meet."""
    start = 0
    for stop in range(1, len(keys) + 1):
        if stop == len(keys) or (keys[stop] is None) != (keys[start] is None):
            yield list(keys[start:stop]), numbers[start:stop]
            start = stop


def _basis_line(plan: _Plan, component: str, is_linear: bool, scaling: str) -> Iterator[str]:
    function = "*".join(["l.Lagrange" if is_linear else "c.Hermite"] * plan.dim)
    used = f" scale factor set={scaling}" if scaling and not is_linear else ""
    yield f" {component}. {function}, no modify, standard node based.{used}"
    yield f"  #Nodes={2**plan.dim}"


def _exnode(plan: _Plan, groups: Mapping[str, IntArray]) -> Iterator[str]:
    """Yield the older file of nodes: every derivative has as many versions as any of its node."""
    yield " Group name: mesh"
    kinds = 2**plan.dim
    derivatives = ",".join(LABELS[1:kinds])
    before = 0
    for node, layout in enumerate(plan.layouts):
        versions = _versions(layout)
        if versions != before:
            before = versions
            yield f" #Fields={len(plan.fields) + len(plan.linear)}"
            for line, components, is_linear in _declared(plan):
                yield " " + line.replace(" real,", "")
                size = 1 if is_linear else kinds * versions
                for number, component in enumerate(components):
                    tail = "" if is_linear else f" ({derivatives})"
                    tail += "" if is_linear or versions == 1 else f", #Versions={versions}"
                    yield (
                        f"  {component}. Value index={1 + number * size}, "
                        f"#Derivatives={0 if is_linear else kinds - 1}{tail}"
                    )
        yield f" Node: {plan.node(node)}"
        for values, is_linear in plan.values(node):
            table = values
            if not is_linear:
                padded = np.zeros((versions, kinds, values.shape[1]))
                padded[:, 0] = values[0]
                for (kind, version), value in zip(layout, values, strict=True):
                    padded[version, kind] = value
                table = padded.reshape(-1, values.shape[1])
            yield from (f"  {_numbers(component)}" for component in table.T)
    for name, elements in groups.items():
        yield f" Group name: {name}"
        yield " #Fields=0"
        yield from (f" Node: {n}" for n in plan.members(elements)[0])


def _versions(layout: tuple[_Key, ...]) -> int:
    return 1 + max(version for _, version in layout)


def _exelem(plan: _Plan, groups: Mapping[str, IntArray]) -> Iterator[str]:
    """Yield the older file of elements: every function has a scale factor."""
    yield " Group name: mesh"
    kinds = 2**plan.dim
    function = "*".join(["c.Hermite"] * plan.dim)
    last: object = None
    for element, keys in enumerate(plan.keys):
        if keys != last:
            last = keys
            yield f" Shape. Dimension={plan.dim}"
            yield " #Scale factor sets=1"
            yield f"  {function}, #Scale factors={4**plan.dim}"
            yield f" #Nodes={kinds}"
            yield f" #Fields={len(plan.fields) + len(plan.linear)}"
            for line, components, is_linear in _declared(plan):
                yield " " + line.replace(" real,", "")
                for component in components:
                    yield from _basis_line(plan, component, is_linear, "")
                    for corner in range(kinds):
                        size = 1 if is_linear else kinds
                        some = keys[corner * kinds : (corner + 1) * kinds]
                        # What takes nothing takes the value, with a factor of zero.
                        indices = [1 + k + kinds * v for k, v in (key or (0, 0) for key in some)]
                        begin = corner * kinds + 1
                        factors = [0] if is_linear else range(begin, begin + kinds)
                        yield f"   {corner + 1}. #Values={size}"
                        yield f"    Value indices: {' '.join(map(str, indices[:size]))}"
                        yield f"    Scale factor indices: {' '.join(map(str, factors))}"
        yield f" Element: {plan.element(element)} 0 0"
        yield "  Nodes:"
        yield "  " + " ".join(str(plan.node(n)) for n in plan.corners[element].tolist())
        yield "  Scale factors:"
        yield f"  {_numbers(plan.scales[element])}"
    for name, elements in groups.items():
        yield f" Group name: {name}"
        yield f" Shape. Dimension={plan.dim}"
        yield from (" #Scale factor sets=0", " #Nodes=0", " #Fields=0")
        yield from (f" Element: {n} 0 0" for n in plan.members(elements)[1])
