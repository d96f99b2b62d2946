"""Reading EX files: version 2 and 3 (``.exf``), and the older ``.exnode`` with ``.exelem``.

The file is read in two passes. The first takes the text apart into nodes and elements, each with
the template that the last header defined; the second makes extraction operators of the elements of
highest dimension. A field in a form that the Hermite space does not hold (simplices, grids, other
coordinate systems, time) is left out; only for the coordinates that is an error.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import Polynomial

from ..errors import InputError
from .basis import Array
from .ex import COORDINATES, LABELS, ExField, ExMesh
from .mesh import HermiteMesh

__all__ = ["read_ex"]

#: Files larger than this (bytes) are not read.
LARGEST = 128 * 2**20
#: Greatest count that a header may announce: of values, components, versions, scale factors.
MOST = 1024

#: Points in [0, 1] of the Lagrange functions by name.
_LAGRANGE = {"l.Lagrange": 2, "q.Lagrange": 3, "c.Lagrange": 4}
_HERMITE = "c.Hermite"


class _Damaged(Exception):
    """Something in the text that cannot be; the message says what."""


class _Unsupported(Exception):
    """A form of field that the Hermite space does not hold."""


@dataclass(frozen=True)
class _NodeField:
    """A field at nodes of one template: labels and versions of every component's values."""

    name: str
    kind: str
    layouts: list[list[tuple[str, int]]]
    numeric: bool


@dataclass(frozen=True)
class _Term:
    """What a basis function takes: of a local node a labelled or counted value, times factors."""

    node: int
    label: str
    version: int
    index: int
    factors: tuple[int, ...]


@dataclass(frozen=True)
class _Component:
    basis: tuple[str, ...]
    functions: list[list[_Term]]
    scaling: str


@dataclass(frozen=True)
class _ElementField:
    name: str
    kind: str
    components: list[_Component]
    fault: str = ""


@dataclass
class _Template:
    """The header of elements."""

    dim: int = 0
    tensor: bool = True
    sets: dict[str, slice] = field(default_factory=dict)
    n_factors: int = 0
    n_nodes: int = 0
    fields: list[_ElementField] = field(default_factory=list)


@dataclass
class _Element:
    nodes: list[int] = field(default_factory=list)
    #: Of every field, its template and this element's scale factors.
    fields: dict[str, tuple[_ElementField, _Template, list[float]]] = field(default_factory=dict)


@dataclass
class _Region:
    """Nodes, elements by dimension and identifier, and groups, as the text has them."""

    values: dict[int, dict[str, tuple[_NodeField, list[list[float]]]]] = field(default_factory=dict)
    elements: dict[int, dict[int, _Element]] = field(default_factory=dict)
    groups: dict[str, dict[int, set[int]]] = field(default_factory=dict)


def read_ex(path: str | Path) -> ExMesh:
    """Read the elements of highest dimension that have coordinates, with their fields.

    Parameters
    ----------
    path : path
        ``name.exf``; or ``name.exnode`` or ``name.exelem``, of which both are read.

    Raises
    ------
    InputError
        There is no such file, it is damaged or too large, or it holds no mesh of three
        coordinates that cubic Hermite or Lagrange elements represent.
    """
    path = Path(path)
    pair = path.suffix in (".exnode", ".exelem")
    if not pair and path.suffix != ".exf":
        raise InputError(f"{path}: no name of an EX file; it ends in .exf, .exnode or .exelem")
    region = _Region()
    files = [path.with_suffix(".exnode"), path.with_suffix(".exelem")] if pair else [path]
    for file in files:
        reader = _Reader(_text(file), region)
        try:
            reader.read()
        except _Damaged as error:
            raise InputError(
                f"{file}: line {reader.line}: {error}; export or copy it anew"
            ) from error
    try:
        return _assembled(region)
    except (_Damaged, _Unsupported) as error:
        raise InputError(f"{path}: {error}; export it anew") from error


def _text(path: Path) -> list[str]:
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: larger than {LARGEST >> 20} MiB; export a part of it")
        return path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); name an EX file") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file; name an EX file") from error


def _count(text: str, most: int = MOST) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise _Damaged(f"{text[:20]!r} is no count")
    if int(text) > most:
        raise _Damaged(f"it announces {text}, more than the {most} that can be")
    return int(text)


def _identifier(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 12:
        raise _Damaged(f"{text[:20]!r} is no identifier")
    return int(text)


def _floats(words: list[str]) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise _Damaged(f"not a number among {' '.join(words)[:40]!r}") from None
    if not np.isfinite(values).all():
        raise _Damaged("a number is not finite")
    return values


class _Reader:
    """Takes the text apart."""

    def __init__(self, lines: list[str], region: _Region) -> None:
        self.lines = lines
        self.line = 0
        self.version = 0
        self.region = region
        self.group: str | None = None
        self.counts_nodes = True
        self.dim = 0
        self.node_fields: list[_NodeField] = []
        self.template = _Template()
        self.named: dict[tuple[str, str], list[_NodeField] | _Template] = {}

    def _peek(self) -> str:
        """Return the next line that says something, stripped; '' at the end."""
        while self.line < len(self.lines):
            text = self.lines[self.line].strip()
            if text and (not text.startswith("!") or text.startswith("!#")):
                return text
            self.line += 1
        return ""

    def _next(self) -> str:
        text = self._peek()
        if not text:
            raise _Damaged("it ends in the middle; it may be truncated")
        self.line += 1
        return text

    def _match(self, pattern: str) -> re.Match[str]:
        text = self._next()
        found = re.match(pattern, text)
        if found is None:
            raise _Damaged(f"not understood: {text[:60]!r}")
        return found

    def read(self) -> None:
        """Read everything."""
        while text := self._peek():
            head, _, rest = text.partition(":")
            rest = rest.strip()
            if head == "EX Version":
                self.version = _count(rest)
                if self.version not in (1, 2, 3):
                    raise _Damaged(f"version {rest} is not known")
                self.line += 1
            elif head == "Region":
                self.group = None
                self.line += 1
                if self.region.elements:
                    raise _Damaged("a second region; one region a file is read")
            elif head == "Group name":
                self.group = rest
                self.region.groups.setdefault(rest, {})
                self.line += 1
            elif text.startswith("!#nodeset"):
                # Data points are no part of the mesh.
                self.counts_nodes = text.split()[1:2] == ["nodes"]
                self.node_fields = []
                self.line += 1
            elif text.startswith("!#mesh"):
                found = re.search(r"dimension=([123])\b", text)
                if found is None:
                    raise _Damaged("a mesh without a dimension of 1, 2 or 3")
                self.template = _Template(dim=int(found[1]))
                self.line += 1
            elif text.startswith("!#"):
                self.line += 1
            elif head in ("Define node template", "Define element template"):
                self.line += 1
                self._define(head.split()[1], rest)
            elif head in ("Node template", "Element template"):
                self.line += 1
                self._use(head.split()[0].lower(), rest)
            elif text.startswith("Shape."):
                self._shape()
            elif text.startswith("#Scale factor sets"):
                self._element_header()
            elif text.startswith("#Fields"):
                self.node_fields = self._node_header()
            elif head == "Node":
                self.line += 1
                self._node(_identifier(rest))
            elif head == "Element":
                self.line += 1
                self._element(rest.split())
            elif head in ("Node group", "Element group"):
                self.line += 1
                self._members(head == "Node group")
            elif head.strip() == "Values":
                # Of fields that are constant or counted: not ours.
                self.line += 1
                self._numbers_until_words()
            else:
                self.line += 1
                raise _Damaged(f"not understood: {text[:60]!r}")

    def _define(self, what: str, name: str) -> None:
        self._shape()
        if what == "node":
            self.named[what, name] = self._node_header()
        else:
            self._element_header()
            self.named[what, name] = self.template

    def _use(self, what: str, name: str) -> None:
        chosen = self.named.get((what, name))
        if chosen is None:
            raise _Damaged(f"no template {name[:40]!r} is defined")
        if isinstance(chosen, _Template):
            self.template = chosen
        else:
            self.node_fields = chosen

    def _shape(self) -> None:
        found = self._match(r"Shape\.\s*Dimension=(\d)\s*(?:,\s*(.*))?$")
        dim = int(found[1])
        if dim > 3:
            raise _Damaged(f"elements of dimension {dim}")
        if dim:
            shape = found[2] or "*".join(["line"] * dim)
            self.template = _Template(dim=dim, tensor=shape == "*".join(["line"] * dim))

    def _members(self, of_nodes: bool) -> None:
        """Read ranges of identifiers; those of elements that there are belong to the group."""
        there = self.region.elements.get(self.template.dim, {})
        while re.match(r"\d[\d.,\s]*$", self._peek()):
            for part in self._next().strip(",").split(","):
                low, _, high = part.strip().partition("..")
                start, stop = _identifier(low), _identifier(high or low)
                if not of_nodes and self.group is not None:
                    members = self.region.groups[self.group].setdefault(self.template.dim, set())
                    members.update(number for number in there if start <= number <= stop)

    # Nodes

    def _declaration(self) -> tuple[str, str, int]:
        found = self._match(r"\d+\)\s*([^,]+),\s*(.*?)#Components\s*=\s*(\d+)")
        count = _count(found[3])
        if not count:
            raise _Damaged(f"the field {found[1].strip()[:40]!r} has no components")
        return found[1].strip(), found[2].strip().rstrip(","), count

    def _node_header(self) -> list[_NodeField]:
        fields = []
        for _ in range(_count(self._match(r"#Fields=\s*(\d+)")[1])):
            name, kind, components = self._declaration()
            layouts = [self._layout() for _ in range(components)]
            numeric = not re.search(r"\b(string|element_xi)\b", kind)
            fields.append(_NodeField(name, kind, layouts, numeric))
        return fields

    def _layout(self) -> list[tuple[str, int]]:
        text = self._next()
        if "time sequence" in text:
            raise _Damaged("values over time; export one time")
        new = re.match(r"[^.]*\.\s*#Values=\s*(\d+)\s*\((.*)\)$", text)
        if new:
            layout = []
            for item in new[2].split(","):
                found = re.fullmatch(r"\s*([\w/]+)\s*(?:\((\d+)\))?\s*", item)
                if found is None:
                    raise _Damaged(f"not a value's name: {item[:30]!r}")
                layout += [(found[1], v + 1) for v in range(_count(found[2] or "1"))]
                if len(layout) > MOST:
                    raise _Damaged(f"more than {MOST} values of one component")
            if len(layout) != _count(new[1]):
                raise _Damaged(f"{new[1]} values announced, {len(layout)} named")
            return layout
        old = re.match(r"[^.]*\.\s*Value index=\s*\d+\s*,\s*#Derivatives=\s*(\d+)(.*)$", text)
        if old is None:
            raise _Damaged(f"not understood: {text[:60]!r}")
        derivatives = _count(old[1])
        named = re.search(r"\(([^)]*)\)", old[2])
        labels = [word.strip() for word in named[1].split(",")] if named else list(LABELS[1:])
        if derivatives > len(labels):
            raise _Damaged(f"{derivatives} derivatives announced, {len(labels)} named")
        versions = re.search(r"#Versions=\s*(\d+)", old[2])
        count = _count(versions[1]) if versions else 1
        if count * (1 + derivatives) > MOST:
            raise _Damaged(f"{count} versions of {1 + derivatives} values are too many")
        return [
            (label, version + 1)
            for version in range(count)
            for label in ["value", *labels[:derivatives]]
        ]

    def _node(self, identifier: int) -> None:
        if not self.node_fields:
            return
        store = self.region.values.setdefault(identifier, {}) if self.counts_nodes else {}
        words: list[str] = []

        def take(count: int) -> list[str]:
            while len(words) < count:
                words.extend(self._next().split())
            taken = words[:count]
            del words[:count]
            return taken

        for item in self.node_fields:
            if not item.numeric:
                # One line for each component.
                for _ in item.layouts:
                    self._next()
                continue
            if any(word in item.kind for word in ("constant", "indexed")):
                continue
            store[item.name] = item, [_floats(take(len(layout))) for layout in item.layouts]
        if words:
            raise _Damaged(f"more values than announced for node {identifier}")

    # Elements

    def _element_header(self) -> None:
        template = _Template(self.template.dim, self.template.tensor)
        self.template = template
        sets = _count(self._match(r"#Scale factor sets\s*=\s*(\d+)")[1])
        for _ in range(sets):
            found = self._match(r"([^,]+),\s*#Scale factors\s*=\s*(\d+)")
            start = template.n_factors
            template.n_factors += _count(found[2])
            template.sets[found[1].strip()] = slice(start, template.n_factors)
        template.n_nodes = _count(self._match(r"#Nodes\s*=\s*(\d+)")[1])
        for _ in range(_count(self._match(r"#Fields\s*=\s*(\d+)")[1])):
            name, kind, count = self._declaration()
            components, fault = [], ""
            for _ in range(count):
                try:
                    components.append(self._component(template))
                except _Unsupported as error:
                    fault = str(error)
                    self._skip_component()
            template.fields.append(_ElementField(name, kind, components, fault))

    def _skip_component(self) -> None:
        """Pass over the rest of a component's header."""
        ahead = re.compile(r".*\bbased\b|\d+\)|Element|Node|Shape|#Scale|Group|Define|!#")
        while (text := self._peek()) and not ahead.match(text):
            self.line += 1

    def _component(self, template: _Template) -> _Component:
        text = self._next()
        found = re.match(r"[^.]*\.\s*([^,]+),\s*([^,]+),\s*([^.,]+)[.,]?(.*)$", text)
        if found is None:
            raise _Damaged(f"not understood: {text[:60]!r}")
        names = tuple(word.strip() for word in found[1].split("*"))
        if found[2].strip() != "no modify" or found[3].strip() != "standard node based":
            raise _Unsupported(f"{found[2].strip()}, {found[3].strip()}")
        known = all(name == _HERMITE or name in _LAGRANGE for name in names)
        if not template.tensor or len(names) != template.dim or not known:
            raise _Unsupported(f"interpolated by {found[1].strip()}")
        scaling = re.search(r"scale factor set\s*=\s*(\S+)", found[4])
        n_nodes = _count(self._match(r"#Nodes\s*=\s*(\d+)")[1])
        size = int(np.prod([4 if n == _HERMITE else _LAGRANGE[n] for n in names]))
        functions: list[list[_Term]] = []
        while len(functions) < size:
            functions += self._terms(n_nodes, template)
        if len(functions) != size:
            raise _Damaged(f"{len(functions)} functions where {size} belong")
        return _Component(names, functions, scaling[1] if scaling else found[1].strip())

    def _terms(self, n_nodes: int, template: _Template) -> Iterator[list[_Term]]:
        found = self._match(r"([\d+]+)\.\s*#Values\s*=\s*(\d+)")
        nodes = [_count(word) for word in found[1].split("+")]
        if max(nodes) > max(n_nodes, template.n_nodes):
            raise _Damaged(f"local node {max(nodes)} of {n_nodes}")
        count = _count(found[2])
        if not count:
            raise _Damaged("a node without values")
        named = self._match(r"Value (labels|indices)\s*:\s*(.*)$")
        words = named[2].split()
        factors = [""] * count
        if self._peek().startswith("Scale factor indices"):
            factors = self._next().partition(":")[2].split()
        if len(words) != count or len(factors) != count:
            raise _Damaged(f"{count} values announced, {len(words)} named")
        for word, scaling in zip(words, factors, strict=True):
            labels = word.split("+")
            scales = scaling.split("+") if scaling else [""] * len(labels)
            if len(scales) != len(labels) or (len(nodes) > 1 and len(nodes) != len(labels)):
                raise _Damaged(f"not understood: {word[:40]!r} scaled by {scaling[:40]!r}")
            owners = nodes if len(nodes) > 1 else nodes * len(labels)
            yield [
                self._term(node, label, scale, named[1] == "indices")
                for node, label, scale in zip(owners, labels, scales, strict=True)
                if node and label != "zero"
            ]

    @staticmethod
    def _term(node: int, label: str, scale: str, counted: bool) -> _Term:
        # An index of 0 means a factor of 1.
        factors = tuple(n for n in (_count(word) for word in scale.split("*") if word) if n)
        if counted:
            return _Term(node - 1, "", 0, _count(label) - 1, factors)
        found = re.fullmatch(r"([\w/]+)(?:\((\d+)\))?", label)
        if found is None:
            raise _Damaged(f"not a value's name: {label[:30]!r}")
        return _Term(node - 1, found[1], _count(found[2] or "1"), -1, factors)

    def _numbers_until_words(self) -> list[str]:
        words: list[str] = []
        while re.match(r"[-+.\d]", self._peek()) and not re.match(r"\d+\)", self._peek()):
            words += self._next().split()
        return words

    def _element(self, words: list[str]) -> None:
        template = self.template
        if len(words) == 3:
            # Older files: the number is that of an element, a face or a line.
            identifier = _identifier(next((word for word in words if word != "0"), "0"))
        elif len(words) == 1:
            identifier = _identifier(words[0])
        else:
            raise _Damaged("an element without a number")
        found: dict[str, list[str]] = {}
        while (text := self._peek()).rstrip(" :") in ("Faces", "Nodes", "Scale factors", "Values"):
            self.line += 1
            found[text.rstrip(" :")] = self._numbers_until_words()
        if not template.dim:
            raise _Damaged("an element before the shape of elements")
        element = self.region.elements.setdefault(template.dim, {}).setdefault(
            identifier, _Element()
        )
        if self.group is not None:
            members = self.region.groups[self.group].setdefault(template.dim, set())
            members.add(identifier)
        if not template.fields:
            return
        nodes = [_identifier(word) for word in found.get("Nodes", [])]
        scales = _floats(found.get("Scale factors", []))
        if len(nodes) != template.n_nodes or len(scales) != template.n_factors:
            raise _Damaged(
                f"element {identifier} has {len(nodes)} nodes and {len(scales)} scale factors, "
                f"announced are {template.n_nodes} and {template.n_factors}"
            )
        element.nodes = nodes
        for item in template.fields:
            element.fields[item.name] = item, template, scales


def _assembled(region: _Region) -> ExMesh:
    """Make the mesh of the elements of highest dimension that have coordinates."""
    for dim in (3, 2, 1):
        elements = dict(sorted(region.elements.get(dim, {}).items()))
        name = _coordinates(elements)
        if name:
            break
    else:
        raise _Damaged("there are no elements with coordinates")
    chosen = {number: e for number, e in elements.items() if name in e.fields}
    fields = {name: _field(name, dim, list(chosen.values()), region)}
    main = fields.pop(name)
    if main.n_components != 3:
        raise _Unsupported(f"{name} has {main.n_components} components and not 3")
    others = dict.fromkeys(key for e in chosen.values() for key in e.fields if key != name)
    for other in others:
        try:
            fields[other] = _field(other, dim, list(chosen.values()), region)
        except _Unsupported:
            continue
    place = {number: index for index, number in enumerate(chosen)}
    groups = {}
    for label, members in region.groups.items():
        inside = sorted(place[number] for number in members.get(dim, ()) if number in place)
        if inside:
            groups[label] = np.array(inside, dtype=np.int64)
    mesh = HermiteMesh(dim, main.parameters, main.extraction)
    return ExMesh(mesh, fields, groups, np.array(list(chosen), dtype=np.int64))


def _coordinates(elements: dict[int, _Element]) -> str:
    """Return the name of the coordinates, '' when there are none."""
    for element in elements.values():
        kinds = {name: item.kind for name, (item, _, _) in element.fields.items()}
        if COORDINATES in kinds:
            return COORDINATES
        named = [name for name, kind in kinds.items() if kind.startswith("coordinate")]
        if named:
            return named[0]
    return ""


def _field(name: str, dim: int, elements: list[_Element], region: _Region) -> ExField:
    """Gather a field's parameters from the nodes and its extraction from the elements."""
    used = sorted({n for e in elements if name in e.fields for n in e.nodes})
    columns: dict[tuple[int, str, int], int] = {}
    layouts: dict[int, list[tuple[str, int]]] = {}
    table: list[Array] = []
    for number in used:
        here = region.values.get(number, {}).get(name)
        if here is None:
            continue
        item, values = here
        if any(layout != item.layouts[0] for layout in item.layouts):
            raise _Unsupported(f"{name} has components with different values at node {number}")
        layouts[number] = item.layouts[0]
        for label, version in item.layouts[0]:
            columns[number, label, version] = len(columns)
        table.append(np.array(values).T)
    if not table or len({part.shape[1] for part in table}) != 1:
        raise _Damaged(f"{name} has no values at the nodes, or not always as many components")
    parameters = np.concatenate(table)
    size = 4**dim
    blocks: list[sp.csr_matrix] = []
    defined = np.zeros(len(elements), dtype=bool)
    for place, element in enumerate(elements):
        if name not in element.fields:
            blocks.append(sp.csr_matrix((size, len(columns))))
            continue
        form, template, scales = element.fields[name]
        if form.fault or not form.components:
            raise _Unsupported(f"{name} is {form.fault or 'without components'}")
        if "rectangular cartesian" not in form.kind and form.kind.startswith("coordinate"):
            raise _Unsupported(f"{name} is not in rectangular cartesian coordinates")
        first = form.components[0]
        if any(c.basis != first.basis or c.functions != first.functions for c in form.components):
            raise _Unsupported(f"{name} has components that are interpolated differently")
        if len(form.components) != parameters.shape[1]:
            raise _Damaged(f"{name} has not as many components in elements as at nodes")
        defined[place] = True
        blocks.append(_block(name, first, template, element, scales, columns, layouts))
    extraction = sp.csr_matrix(sp.vstack(blocks, format="csr"))
    # Older files pad nodes with versions that no element takes.
    taken = np.unique(extraction.indices)
    return ExField(name, parameters[taken], extraction[:, taken], defined)


def _block(
    name: str,
    component: _Component,
    template: _Template,
    element: _Element,
    scales: list[float],
    columns: dict[tuple[int, str, int], int],
    layouts: dict[int, list[tuple[str, int]]],
) -> sp.csr_matrix:
    """Return the local Hermite parameters of one element over the field's parameters."""
    own = scales[template.sets.get(component.scaling, slice(0, 0))]
    rows, places, data = [], [], []
    for row, terms in enumerate(component.functions):
        for term in terms:
            if term.node >= len(element.nodes):
                raise _Damaged(f"{name} refers to a local node that there is not")
            node = element.nodes[term.node]
            label, version = term.label, term.version
            if term.index >= 0:
                layout = layouts.get(node, [])
                if term.index >= len(layout):
                    raise _Damaged(f"{name} takes value {term.index + 1} of node {node}")
                label, version = layout[term.index]
            column = columns.get((node, label, version))
            if column is None:
                raise _Damaged(f"{name} takes {label}({version}) of node {node}, which it has not")
            if term.factors and max(term.factors) > len(own):
                raise _Damaged(f"{name} takes a scale factor that there is not")
            rows.append(row)
            places.append(column)
            data.append(float(np.prod([own[n - 1] for n in term.factors])))
    shape = (len(component.functions), len(columns))
    taken = sp.csr_matrix((data, (rows, places)), shape=shape)
    if all(basis == _HERMITE for basis in component.basis):
        return taken
    return sp.csr_matrix(sp.csr_matrix(_to_hermite(component.basis)) @ taken)


def _to_hermite(names: tuple[str, ...]) -> Array:
    """Return the (4**dim, functions) map from a tensor basis to cubic Hermite functions."""
    dim = len(names)
    parts = [_line(name) for name in names]
    total = np.zeros((4**dim, int(np.prod([part.shape[1] for part in parts]))))
    # Functions are counted node by node, the first direction fastest, with the derivatives of the
    # Hermite directions at every node.
    kinds = [2 if name == _HERMITE else 1 for name in names]
    nodes = [part.shape[1] // kind for part, kind in zip(parts, kinds, strict=True)]
    column = 0
    for node in np.ndindex(*nodes[::-1]):
        for kind in np.ndindex(*kinds[::-1]):
            factors = [
                part[:, n * count + d].reshape(2, 2)
                for part, n, d, count in zip(parts, node[::-1], kind[::-1], kinds, strict=True)
            ]
            block = factors[0]
            for factor in factors[1:]:
                block = np.einsum("sk,SK->sSkK", factor, block).reshape(
                    2 * block.shape[0], 2 * block.shape[1]
                )
            total[:, column] = block.ravel()
            column += 1
    return total


def _line(name: str) -> Array:
    """Return value and derivative at 0 and 1 (4 rows) of the functions of one direction."""
    if name == _HERMITE:
        return np.eye(4)
    places = np.linspace(0.0, 1.0, _LAGRANGE[name])
    out = np.zeros((4, len(places)))
    for k, place in enumerate(places):
        others = np.delete(places, k)
        function = Polynomial.fromroots(others) / np.prod(place - others)
        slope = function.deriv()
        out[:, k] = [function(0.0), slope(0.0), function(1.0), slope(1.0)]
    return out
