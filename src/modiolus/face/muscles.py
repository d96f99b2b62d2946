"""The muscles of one side, built from anatomy.

Each is a thin body. Conformal coordinates on its two sheets (`modiolus.anatomy.sheet`) give a
first Hermite volume whose lines of constant ξ2 are the streamlines of the Laplace field from
origin to insertion; least squares then bring its six sides to the muscle's surface, while the
lines keep their course.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from modiolus.anatomy import MIDPLANE, BodyParts3D, Surface
from modiolus.anatomy.sheet import Sheet, clean_skin, ring, strip
from modiolus.errors import SolveError, unknown_name
from modiolus.face.malar import MALAR
from modiolus.face.muscle import Muscle
from modiolus.fitting import CloudTarget, PointTarget, Smoothing, fit
from modiolus.hermite import HermiteMesh, grid
from modiolus.hermite.tessellate import tessellate
from modiolus.progress import Progress

__all__ = ["FITTED", "MUSCLES", "MuscleQuality", "build_muscles", "muscle_quality", "muscle_table"]

Directions = Sequence[tuple[float, float, float]]


@dataclass(frozen=True)
class _Source:
    """How the coordinates of a structure are laid."""

    kind: str
    corners: Directions
    """Strips: the directions of the corners origin-a, origin-b, insertion-b, insertion-a. Rings:
    the one direction in which they begin."""
    reason: str
    """Why these are origin and insertion, and what is known about the source."""
    spacing: float = 0.4
    lowest: float = -np.inf
    """Height at which the structure is cut (mm)."""
    medial: bool = False
    """Whether the side from origin-a to insertion-a lies in the mid-plane."""


_SOURCES = {
    "zygomaticus_major": _Source(
        "strap",
        ((0, -0.4, 1), (0, 1, 0.6), (0, 0, -1), (0, -1, 0)),
        "from the zygomatic bone above and behind, frayed, to the modiolus below and in front",
    ),
    "zygomaticus_minor": _Source(
        "strap",
        ((0.3, 0, 1), (1, 0, -0.2), (0.2, 0, -1), (-1, 0, -0.2)),
        "from the zygomatic bone, the upper lateral end, to the upper lip, the lower medial end",
    ),
    "levator_labii_superioris": _Source(
        "sheet",
        ((-0.2, 0, 1), (1, 0, 0), (0.3, 0, -1), (-1, 0, -0.6)),
        "from the infraorbital rim, its long upper edge with a lateral tip, to the upper lip",
    ),
    "levator_labii_superioris_alaeque_nasi": _Source(
        "strap",
        ((-0.5, -0.2, 1), (0, 1, 0.5), (0, 0.5, -1), (0, -0.5, -1)),
        "from the frontal process of the maxilla above to the ala and the upper lip below",
        spacing=0.3,
    ),
    "levator_anguli_oris": _Source(
        "sheet",
        ((-0.5, 0, 1), (0.6, 0, 1), (1, 0, -1), (-1, 0, 0)),
        "from the canine fossa, the frayed upper edge, to the oblique lower edge",
    ),
    "risorius": _Source(
        "sheet",
        ((0, 0.3, 1), (0, 0.3, -1), (0, -1, -0.3), (0, -1, 0.3)),
        "from the parotid fascia, the wide frayed hind edge, to the modiolus, the narrow front",
    ),
    "buccinator": _Source(
        "sheet",
        ((0, 0.4, 1), (0, 1, -0.35), (0, 0, -1), (0, -1, 0.5)),
        "the source's bundles spread from the raphe, its upper hind end, to the front edge",
    ),
    "depressor_anguli_oris": _Source(
        "sheet",
        ((-1, 0, -0.3), (0, 1, -0.3), (0, 0.3, 1), (0, -0.6, 1)),
        "from the base of the mandible, its frayed lower edge, to the modiolus, the upper tip",
    ),
    "depressor_labii_inferioris": _Source(
        "sheet",
        ((0, 0, -1), (1, 0, 0), (0.3, 0, 1), (-1, 0, 0)),
        "from the mandible, its lower lateral edge, to the lower lip, its upper medial edge",
    ),
    "mentalis": _Source(
        "sheet",
        ((-0.3, 0, 1), (1, 0, 0.3), (0.4, 0, -1), (-1, 0, -0.1)),
        "from the incisive fossa of the mandible above down to the skin of the chin",
        spacing=0.3,
    ),
    "platysma": _Source(
        "sheet",
        ((-1, 0, -1), (0.3, 1, -1), (0, 0.3, 1), (0, -1, 0)),
        "from the neck below to the mandible and the lower lip; cut by a plane through the neck, "
        "below the tissue's own cut",
        spacing=0.8,
        lowest=1400.0,
        medial=True,
    ),
    "frontalis": _Source(
        "sheet",
        ((-1, 0, 0.5), (0, 1, 0.3), (0.6, 0.2, -1), (-1, 0, -1)),
        "from the galea, the upper arc, to the skin of the brow, the lower edge",
        spacing=0.8,
        medial=True,
    ),
    "corrugator_supercilii": _Source(
        "strap",
        ((-1, 0, 0.2), (0, 0, -1), (1, 0, -0.3), (0.3, 0, 1)),
        "from the medial brow ridge, the lower medial end, to the skin over the brow",
        spacing=0.3,
    ),
    "procerus": _Source(
        "sheet",
        ((-1, 0, -1), (0.3, 0, -1), (1, 0, 0.1), (-1, 0, 1)),
        "from the nasal bone below, fanning into the skin of the glabella above",
        medial=True,
    ),
    "nasalis": _Source(
        "sheet",
        ((0, -0.45, -1), (0.2, 0.35, -1), (0, 0, 1), (0, -1, -0.1)),
        "from the maxilla, the lower tip from which the source's bundles fan out, to the bridge of "
        "the nose in front",
    ),
    "depressor_septi_nasi": _Source(
        "sheet",
        ((-1, 0, -1), (1, 0, 0.5), (0.4, 0, 1), (-1, 0, 0.35)),
        "from the maxilla, the lower edge and lateral end, to the septum, the upper medial edge",
        spacing=0.3,
        medial=True,
    ),
    "orbicularis_oris": _Source(
        "ring",
        ((0, 0, 1),),
        "one ring of both sides; it begins in the middle of the upper lip",
        0.6,
    ),
    "orbicularis_oculi_orbital": _Source(
        "ring", ((-1, 0, 0),), "begins at the medial orbit, where its fibres come from bone", 0.6
    ),
    "orbicularis_oculi_palpebral": _Source(
        "ring", ((-1, 0, -0.1),), "begins at the medial canthal tendon"
    ),
}


@dataclass(frozen=True)
class _Recipe:
    """Which part of a source becomes which muscle."""

    source: str
    counts: tuple[int, int]
    """Elements along and across."""
    along: tuple[float, float] = (0.0, 1.0)
    """Part of the source's coordinate along; a ring's from its beginning, either way round."""
    split: tuple[int, int] | None = None
    """Elements across that belong to the muscle, when a source is fitted whole and then shared."""


_RECIPES = {
    "zygomaticus_major": _Recipe("zygomaticus_major", (5, 2)),
    "zygomaticus_minor": _Recipe("zygomaticus_minor", (5, 1)),
    "levator_labii_superioris": _Recipe("levator_labii_superioris", (4, 2)),
    "levator_labii_superioris_alaeque_nasi": _Recipe(
        "levator_labii_superioris_alaeque_nasi", (4, 1)
    ),
    "levator_anguli_oris": _Recipe("levator_anguli_oris", (3, 3)),
    "risorius": _Recipe("risorius", (4, 2)),
    "buccinator": _Recipe("buccinator", (4, 3)),
    "depressor_anguli_oris": _Recipe("depressor_anguli_oris", (5, 2)),
    "depressor_labii_inferioris": _Recipe("depressor_labii_inferioris", (3, 4)),
    "mentalis": _Recipe("mentalis", (3, 2)),
    "platysma": _Recipe("platysma", (6, 5)),
    "orbicularis_oris_upper": _Recipe("orbicularis_oris", (5, 2), (0.0, -0.25)),
    "orbicularis_oris_lower": _Recipe("orbicularis_oris", (5, 2), (-0.5, -0.25)),
    "orbicularis_oculi_orbital": _Recipe("orbicularis_oculi_orbital", (10, 2)),
    "orbicularis_oculi_palpebral": _Recipe("orbicularis_oculi_palpebral", (12, 1)),
    "frontalis_medial": _Recipe("frontalis", (5, 4), split=(0, 1)),
    "frontalis_lateral": _Recipe("frontalis", (5, 4), split=(1, 4)),
    "corrugator_supercilii": _Recipe("corrugator_supercilii", (4, 2)),
    "procerus": _Recipe("procerus", (4, 2)),
    "nasalis": _Recipe("nasalis", (4, 3)),
    "depressor_septi_nasi": _Recipe("depressor_septi_nasi", (3, 2)),
}

#: Those with a source, by name, and all muscles of one side.
FITTED = tuple(_RECIPES)
MUSCLES = (*FITTED, MALAR)


def build_muscles(
    anatomy: BodyParts3D, names: Iterable[str] = FITTED, quiet: bool = True
) -> dict[str, Muscle]:
    """Build muscles of the left side.

    Parameters
    ----------
    anatomy : BodyParts3D
        Where their surfaces come from.
    names : iterable of str
        Which of `FITTED`; all by default.
    quiet : bool
        Whether to show no progress.

    Returns
    -------
    dict of Muscle
        By name, in the order asked for.

    Raises
    ------
    InputError
        A name is not known, or a source cannot be read.
    SolveError
        A muscle's rim cannot be followed, or its mesh folds.
    """
    names = list(names)
    for name in names:
        if name not in _RECIPES:
            raise unknown_name("muscle", name, FITTED)
    sheets: dict[str, Sheet] = {}
    wholes: dict[str, HermiteMesh] = {}
    muscles = {}
    with Progress("building muscles", len(names), quiet) as progress:
        for done, name in enumerate(names):
            progress.update(done, name)
            recipe = _RECIPES[name]
            source = _SOURCES[recipe.source]
            surface = anatomy.surface(recipe.source)
            if recipe.source not in sheets:
                sheets[recipe.source] = _sheet(surface, source)
            key = name if recipe.split is None else recipe.source
            if key not in wholes:
                wholes[key] = _fitted(sheets[recipe.source], surface, source, recipe)
            mesh = wholes[key]
            if recipe.split is not None:
                mesh = mesh.subset(_columns(recipe, mesh))
            muscles[name] = Muscle(name, mesh, source.kind)
        progress.update(len(names))
    return muscles


def _sheet(surface: Surface, source: _Source) -> Sheet:
    box = None
    if np.isfinite(source.lowest):
        box = surface.bounds + np.array([[-5.0], [5.0]])
        box[0, 2] = source.lowest
    closed = source.kind == "ring"
    skin = clean_skin(surface, source.spacing, 1.0, int(closed), box)
    if closed:
        return ring(skin, source.spacing, source.corners[0])
    return strip(skin, source.spacing, source.corners)


#: Samples an element in each direction by which the sheets' coordinates are handed on.
_SAMPLES = 6


def _fitted(sheet: Sheet, surface: Surface, source: _Source, recipe: _Recipe) -> HermiteMesh:
    """Fit a volume to a part of a sheet."""
    periodic = sheet.closed and recipe.along == (0.0, 1.0)
    n1, n2 = recipe.counts
    place, sizes = _even_places(sheet, recipe.along)
    # The two sheets meet in the rim: coordinates are taken half a thickness inside it.
    inset = np.clip(surface.volume / surface.area / sizes, 0.0, 0.08)
    if sheet.closed:
        inset[0] = 0.0

    def sampled(m1: int, m2: int) -> tuple[np.ndarray, np.ndarray]:
        s = np.clip(np.linspace(0.0, 1.0, m1 + 1), inset[0], 1.0 - inset[0])
        t = np.clip(np.linspace(0.0, 1.0, m2 + 1), inset[1], 1.0 - inset[1])
        grids = np.meshgrid(s, t, indexing="ij")
        along, across = place(*(g.ravel() for g in grids))
        both = [sheet.points(side, along, across).reshape(m1 + 1, m2 + 1, 3) for side in (0, 1)]
        return np.stack(grids, axis=-1), np.stack(both, axis=2)

    nodes = sampled(n1, n2)[1]
    where, dense = sampled(n1 * _SAMPLES, n2 * _SAMPLES)
    turned = _is_left_handed(nodes)
    if turned:
        nodes, dense = nodes[:, ::-1], dense[:, ::-1]
        where = where[:, ::-1] * [1.0, -1.0] + [0.0, 1.0]
    mesh = grid(nodes[:-1] if periodic else nodes, (periodic, False, False))
    course = _course(where, dense, (n1, n2))
    fixed = _medial(mesh, recipe, source, turned)
    mesh = mesh.with_parameters(_onto_midplane(mesh.parameters, fixed))
    clouds = _clouds(sheet, surface, source, recipe, periodic)
    # More smoothing until no element folds: where the source tapers to nothing, a muscle keeps
    # some of its thickness (second derivatives 13 and 23).
    for weight in _WEIGHTS:
        smoothing = Smoothing(
            first=0.0,
            second=[0.1 * weight, 0.1 * weight, 30.0, 0.1 * weight, weight, weight],
        )
        keep = [replace(course, weight=w) for w in (1.0, 0.1)]
        start = fit(mesh, keep[:1], smoothing, fixed=fixed, iterations=1).mesh
        done = fit(start, [keep[1], *clouds], smoothing, fixed=fixed, iterations=4).mesh
        if least_jacobian(done) > _LEAST_JACOBIAN:
            return done
    raise SolveError(f"{recipe.source}: its mesh folds; use fewer elements or other corners")


#: Smallest scaled Jacobian that a muscle may have anywhere.
_LEAST_JACOBIAN = 0.08

#: Weights of the thickness's evenness, tried in turn.
_WEIGHTS = (0.5, 1.0, 2.0, 4.0, 10.0, 30.0)


def _even_places(
    sheet: Sheet, part: tuple[float, float]
) -> tuple[Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """Find the coordinates that go evenly along and across a part of a sheet.

    Conformal coordinates crowd where the sheet is narrow. Each is traded for the share of the
    mean length of its lines; lines stay the same. The mean lengths along and across come too.
    """
    fine = np.linspace(0.0, 1.0, 41)
    u, v = np.meshgrid(part[0] + (part[1] - part[0]) * fine, fine, indexing="ij")
    along = u % 1.0 if sheet.closed else u
    both = [sheet.points(side, along.ravel(), v.ravel()) for side in (0, 1)]
    middle = np.mean(both, axis=0).reshape(*u.shape, 3)
    shares, sizes = [], np.empty(2)
    for axis in (0, 1):
        steps = np.linalg.norm(np.diff(middle, axis=axis), axis=2).mean(axis=1 - axis)
        sizes[axis] = steps.sum()
        shares.append(np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum())

    def place(s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along = part[0] + (part[1] - part[0]) * np.interp(s, shares[0], fine)
        return along % 1.0 if sheet.closed else along, np.interp(t, shares[1], fine)

    return place, sizes


def _is_left_handed(nodes: np.ndarray) -> bool:
    """Tell whether along × across points from the outer to the inner sheet."""
    middle = nodes.mean(axis=2)
    along = np.diff(middle, axis=0)[:, :-1]
    across = np.diff(middle, axis=1)[:-1]
    out = (nodes[:, :, 1] - nodes[:, :, 0])[:-1, :-1]
    return bool((np.cross(along, across) * out).sum() < 0.0)


def _course(where: np.ndarray, dense: np.ndarray, counts: tuple[int, int]) -> PointTarget:
    """Tie points of a fine grid on both sheets to their places in the mesh."""
    scaled = where * counts
    cells = np.minimum(scaled.astype(np.int64), np.array(counts) - 1)
    elements = cells[..., 0] + counts[0] * cells[..., 1]
    xi = np.concatenate([scaled - cells, np.zeros((*elements.shape, 1))], axis=-1)
    both = [xi, xi + np.array([0.0, 0.0, 1.0])]
    return PointTarget(
        "course",
        np.tile(elements.ravel(), 2),
        np.concatenate([x.reshape(-1, 3) for x in both]),
        np.concatenate([dense[:, :, side].reshape(-1, 3) for side in (0, 1)]),
    )


def _columns(recipe: _Recipe, mesh: HermiteMesh) -> np.ndarray:
    """Return the elements of the muscle in a mesh that several share."""
    assert recipe.split is not None
    n1, n2 = recipe.counts
    # Whichever way the mesh runs across, its first column is the medial one when it is nearer
    # the mid-plane.
    x = [mesh.evaluate([n1 * j], [[0.5, 0.5, 0.5]])[0, 0] for j in (0, n2 - 1)]
    columns = np.arange(*recipe.split) if x[0] < x[1] else n2 - 1 - np.arange(*recipe.split)
    return (np.sort(columns)[:, None] * n1 + np.arange(n1)).ravel()


def _medial(mesh: HermiteMesh, recipe: _Recipe, source: _Source, turned: bool) -> np.ndarray:
    """Mark what keeps the medial border in the mid-plane: x and its derivatives within it."""
    n1, n2 = recipe.counts
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    halves = source.kind == "ring" and recipe.along != (0.0, 1.0)
    if not (source.medial or halves):
        return fixed
    axis, last = (0, False) if halves else (1, turned)
    i, j, k = np.meshgrid(np.arange(n1 + 1), np.arange(n2 + 1), np.arange(2), indexing="ij")
    node = i + (n1 + 1) * (j + (n2 + 1) * k)
    chosen = np.take(node, -1 if last else 0, axis=axis).ravel()
    within = [kind for kind in range(8) if not kind >> axis & 1]
    fixed[(8 * chosen[:, None] + within).ravel(), 0] = True
    return fixed


def _onto_midplane(parameters: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    moved = parameters.copy()
    moved[fixed] = 0.0
    values = fixed[:, 0] & (np.arange(len(fixed)) % 8 == 0)
    moved[values, 0] = MIDPLANE
    return moved


def _clouds(
    sheet: Sheet,
    surface: Surface,
    source: _Source,
    recipe: _Recipe,
    periodic: bool,
) -> list[CloudTarget]:
    """Share the points of the source's surface among the sides of the mesh.

    Each point belongs to the sheet or to the rim on which the nearest vertex of the clean skin
    lies, so that the two sheets of a thin muscle cannot be taken for each other.
    """
    n1, n2 = recipe.counts
    points = _source_points(sheet, surface, source, recipe)
    nearest = sheet.surface.closest(points)
    side = sheet.side[sheet.surface.faces[nearest.faces]].max(axis=1)
    elements = np.arange(n1 * n2)
    first, column = elements % n1, elements // n1
    rims: list[tuple[np.ndarray, int, int]] = [
        (elements[column == 0], 1, 0),
        (elements[column == n2 - 1], 1, 1),
    ]
    if not periodic and source.kind != "ring":
        rims += [(elements[first == 0], 0, 0), (elements[first == n1 - 1], 0, 1)]

    def rim(current: HermiteMesh) -> HermiteMesh:
        faces = [current.face(*which) for which in rims]
        return HermiteMesh(2, current.parameters, sp.vstack([f.extraction for f in faces]).tocsr())

    targets = [
        CloudTarget("deep", lambda m: m.face(elements, 2, 0), points[side == 0], 1.0, 0.02, 3.0),
        CloudTarget(
            "superficial", lambda m: m.face(elements, 2, 1), points[side == 1], 1.0, 0.02, 3.0
        ),
        CloudTarget("rim", rim, points[side == -1], 1.0, 0.1, 3.0),
    ]
    return [target for target in targets if len(target.points)]


def _source_points(sheet: Sheet, surface: Surface, source: _Source, recipe: _Recipe) -> np.ndarray:
    """Spread points over the part of a source's surface that a recipe takes."""
    points = surface.samples(float(np.clip(np.sqrt(surface.area / 3000.0), 0.3, 1.5)))
    points = points[points[:, 2] > source.lowest]
    if source.kind == "ring" and recipe.along != (0.0, 1.0):
        nearest = sheet.surface.closest(points)
        along = sheet.along[sheet.surface.faces[nearest.faces][:, 0]]
        low, high = sorted(recipe.along)
        # Halves end at the mid-plane, which the harmonic angle follows only nearly.
        near = (along - low) % 1.0 <= high - low
        near |= ((along - low + 0.03) % 1.0 <= high - low + 0.06) & (points[:, 0] < 10.0)
        points = points[near & (points[:, 0] > MIDPLANE)]
    return points


def outer_faces(mesh: HermiteMesh) -> list[tuple[int, int, int]]:
    """Return the faces of a volume that no two elements share, each (element, axis, side)."""
    corners = Muscle("mesh", mesh, "strap").corners
    seen: dict[tuple[int, ...], list[tuple[int, int, int]]] = {}
    for axis in range(3):
        for side in (0, 1):
            picked = [c for c in range(8) if c >> axis & 1 == side]
            for element, nodes in enumerate(np.sort(corners[:, picked], axis=1).tolist()):
                seen.setdefault(tuple(nodes), []).append((element, axis, side))
    return [faces[0] for faces in seen.values() if len(faces) == 1]


def least_jacobian(mesh: HermiteMesh) -> float:
    """Smallest scaled Jacobian on 5×5×5 points an element, borders included."""
    return float(mesh.scaled_jacobian(*_ticks(mesh)).min())


@dataclass(frozen=True)
class MuscleQuality:
    """How well a muscle stands for its source.

    Parameters
    ----------
    name, kind : str
        The muscle, or the names of those that share a source; and what it is.
    rms, maximum : float
        Distance between the muscle's boundary and the source's surface, both ways (mm).
    volume, source_volume : float
        Volumes of the muscle and of the source, as far as the muscle takes it (mm³).
    jacobian : float
        Smallest Jacobian determinant at 5×5×5 points an element, borders included (mm³).
    scaled_jacobian : float
        The same of unit tangent vectors.
    length : float
        Mean length along the fibres (mm).
    angle : float
        Mean angle between the fibres and the muscle's longest principal axis (degrees).
    """

    name: str
    kind: str
    rms: float
    maximum: float
    volume: float
    source_volume: float
    jacobian: float
    scaled_jacobian: float
    length: float
    angle: float


def muscle_quality(muscles: Mapping[str, Muscle], anatomy: BodyParts3D) -> list[MuscleQuality]:
    """Compare muscles with the surfaces from which they were built.

    Parameters
    ----------
    muscles : dict of Muscle
        As from `build_muscles`; muscles of one source are compared together when all are there.
    anatomy : BodyParts3D
        Where their surfaces come from.
    """
    by_source: dict[str, list[Muscle]] = {}
    for name, muscle in muscles.items():
        by_source.setdefault(_RECIPES[name].source, []).append(muscle)
    return [
        row
        for name, parts in by_source.items()
        for row in _qualities(parts, anatomy.surface(name), _SOURCES[name])
    ]


def _qualities(parts: list[Muscle], surface: Surface, source: _Source) -> Iterator[MuscleQuality]:
    half = any(_RECIPES[part.name].along != (0.0, 1.0) for part in parts)

    def kept(points: np.ndarray) -> np.ndarray:
        lowest = max(source.lowest + 1.0, surface.bounds[0, 2] - 1.0)
        return np.asarray((points[:, 2] > lowest) & ((points[:, 0] > MIDPLANE) | (not half)))

    data = surface.samples(float(np.clip(np.sqrt(surface.area / 8000.0), 0.3, 1.2)))
    data = data[kept(data)]
    spacing = float(np.clip((surface.volume / 30000.0) ** (1 / 3), 0.2, 1.0))
    low, high = surface.bounds
    axes = [np.arange(low[k] + 0.5 * spacing, high[k], spacing) for k in range(3)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = cells[kept(cells)]
    cells = cells[surface.contains(cells)]
    # The cut ends of half a ring are none of the source.
    outsides = [outer_surface(part, ends=part.kind != "ring") for part in parts]
    gaps = np.stack([outside.closest(data).distance for outside in outsides])
    owners = np.stack([part.mesh.locate(cells).distance for part in parts]).argmin(axis=0)
    for number, (part, outside) in enumerate(zip(parts, outsides, strict=True)):
        others = [other for k, other in enumerate(outsides) if k != number]
        points = outside.samples(0.5)
        points = points[kept(points)]
        for other in others:
            points = points[other.closest(points).distance > 0.3]
        both = np.concatenate(
            [gaps[number, gaps.argmin(axis=0) == number], surface.closest(points).distance]
        )
        rule = part.quadrature()
        below = rule.points[:, 2] < source.lowest + 1.0
        elements, xi = _ticks(part.mesh)
        centred = rule.points - rule.weights @ rule.points / rule.weights.sum()
        axis = np.linalg.eigh(centred.T @ (rule.weights[:, None] * centred))[1][:, -1]
        angles = np.degrees(np.arccos(np.clip(np.abs(rule.directions @ axis), 0.0, 1.0)))
        yield MuscleQuality(
            part.name,
            part.kind,
            float(np.sqrt(np.mean(both**2))),
            float(both.max()),
            float(rule.weights[~below].sum()),
            float((owners == number).sum() * spacing**3),
            float(np.linalg.det(part.mesh.jacobian(elements, xi)).min()),
            float(part.mesh.scaled_jacobian(elements, xi).min()),
            part.length(),
            float(rule.weights @ angles / rule.weights.sum()),
        )


def outer_surface(muscle: Muscle, ends: bool = True) -> Surface:
    """Triangulate the outside of a muscle, with or without its two ends."""
    sides = outer_faces(muscle.mesh)
    if not ends:
        sides = [(element, axis, side) for element, axis, side in sides if axis > 0]
    mesh, outward = muscle.mesh.boundary(([element], axis, side) for element, axis, side in sides)
    cut = tessellate(mesh, 8, outward)
    return Surface(cut.points(mesh.parameters), cut.cells, muscle.name)


def _ticks(mesh: HermiteMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return 5×5×5 points an element, borders included."""
    ticks = np.linspace(0.0, 1.0, 5)
    xi = np.stack(np.meshgrid(ticks, ticks, ticks), axis=-1).reshape(-1, 3)
    elements = np.repeat(np.arange(mesh.n_elements), len(xi))
    return elements, np.tile(xi, (mesh.n_elements, 1))


def muscle_table(rows: Iterable[MuscleQuality]) -> str:
    """Return the quality of muscles as a table of plain text.

    Parameters
    ----------
    rows : iterable of MuscleQuality
        As from `muscle_quality`.
    """
    lines = [
        f"{'muscle':38s} {'kind':5s} {'rms':>5s} {'max':>5s} {'volume':>7s} {'ratio':>5s} "
        f"{'min J':>6s} {'scaled':>6s} {'length':>6s} {'angle':>5s}"
    ]
    lines += [
        f"{q.name:38s} {q.kind:5s} {q.rms:5.2f} {q.maximum:5.2f} {q.volume:7.0f} "
        f"{q.volume / q.source_volume:5.2f} {q.jacobian:6.2f} {q.scaled_jacobian:6.2f} "
        f"{q.length:6.1f} {q.angle:5.0f}"
        for q in rows
    ]
    return "\n".join(lines)
