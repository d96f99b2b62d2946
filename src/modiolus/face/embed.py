"""Muscles in the tissue: brought inside it, their share of it, and where they are held.

The skin of the source stems from another release than its muscles, so that parts of some
muscles stand outside the tissue. They are moved in by a smooth map and fitted again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..anatomy.distance import DistanceGrid
from ..anatomy.surface import MIDPLANE, Surface
from ..fitting import PointTarget, Smoothing, fit
from ..hermite import HermiteMesh, Side
from ..hermite.basis import Array, smooth_step
from ..hermite.tessellate import tessellate
from .head import Attachment
from .muscle import Muscle
from .template import COLUMNS, FOLD_COLUMN, JAW_ROW, ROWS

#: Stretch from which passive fibres are taut. The muscles of a resting face are not: a mouth
#: that moves by 10 mm stretches its antagonists by a fifth before they resist.
SLACK = 1.15
#: The lips are sooner: at rest the lower one presses on the teeth by 0.8 kPa, twice as much as the
#: upper one (Hellsing and L'Estrange 1987). With slack it does not follow the corners of a smile
#: up, and the lips part; an upper lip as taut is drawn over the teeth, in folds, as the jaw opens.
TAUT = {"orbicularis_oris_upper": 1.1, "orbicularis_oris_lower": 1.0}

#: Distance that muscles keep from the outer and the inner surface of the tissue (mm).
CLEARANCE = (0.35, 0.1)

#: What holds the tissue around a muscle's bony end: its stiffness (mN/mm), and the share of the
#: length, from the origin, that is held; of a ring that share on either side of its beginning.
#: Frontalis comes from the galea and from no bone (`LOOSE`), platysma from the fascia of the
#: neck, which the cut holds. Orbicularis oculi is a ring that comes from bone at its medial end:
#: the nasal part of the frontal bone, the frontal process of the maxilla and the medial palpebral
#: ligament (Gray's Anatomy, "Face and scalp"); its malar part begins at the rim of the orbit
#: (`modiolus.face.malar`). Muscles that glide need no hold; what is around
#: their origins is loose, and as stiff as a retaining ligament. Around that of depressor septi nasi
#: nothing holds: it lies behind the upper lip, which the vestibule of the mouth parts from the gum,
#: and in 62 % of people the muscle comes out of orbicularis oris there (Rohrich et al. 2000).
ORIGINS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(
        (
            *("zygomaticus_major", "zygomaticus_minor", "levator_labii_superioris"),
            *("levator_labii_superioris_alaeque_nasi", "levator_anguli_oris", "risorius"),
            *("depressor_anguli_oris", "depressor_labii_inferioris", "mentalis"),
            *("corrugator_supercilii", "procerus", "nasalis"),
        ),
        (300.0, 0.12),
    ),
    "buccinator": (300.0, 0.3),
    "orbicularis_oculi_orbital": (2e4, 0.05),
    "orbicularis_oculi_palpebral": (2e4, 0.05),
    "orbicularis_oculi_malar": (2e4, 0.1),
}

#: Share of its length, from the bone, over which a muscle that ends in the skin glides
#: (`Muscle.pulls`); by the rest it is bound to the tissue. Muscles lie in sheaths of loose tissue,
#: and orbicularis oculi, SMAS and skin slide over their origins: held there, the one layer of the
#: mesh could follow no other muscle.
GLIDE = 0.85
#: Those that do not: platysma lies in the superficial fascia, which joins it to the skin all along,
#: and slides with the skin over the deep fascia (Gray's Anatomy, "Neck"). Where its way from the
#: chest to the jaw is hollow it draws the skin out when it is taut. The malar part of orbicularis
#: oculi, in the same layer, has ends in the skin all along (Zufferey 2013, Eur. J. Plast. Surg.
#: 36:345-352).
SUPERFICIAL = ("platysma", "orbicularis_oculi_malar")
#: Those with no bone: frontalis comes from the galea, which slides over the skull with the scalp,
#: and draws down the skin above 60 % of the forehead's height, in everybody (Cotofana et al. 2020,
#: Plast. Reconstr. Surg. 145:1155-1162). They are bound to the tissue at either end alike.
LOOSE = ("frontalis_medial", "frontalis_lateral")

#: Muscles of the source that end at the modiolus. Levator anguli oris, which ends well above it
#: there, is prolonged to where they meet (`modiolus.face.prolonged`).
MODIOLAR = (
    "zygomaticus_major",
    "depressor_anguli_oris",
    "risorius",
    "buccinator",
)
#: Radius of the modiolus (mm).
MODIOLUS_RADIUS = 8.0


def boundary_surface(mesh: HermiteMesh, side: Side, divisions: int = 6) -> Surface:
    """Return a side of a mesh as triangles."""
    face = mesh.face(*side)
    cut = tessellate(face, divisions)
    return Surface(cut.points(face.parameters), cut.cells, "tissue")


#: How far back (mm) the lid part of orbicularis oculi stands in the head: the source's eyeballs
#: and lids stand in front of the skin.
LID_SHIFT = 3.0


def in_life(muscle: Muscle) -> Muscle:
    """Return a muscle with the slack that it has at rest, and gliding as far as it does."""
    name = muscle.name
    glide = GLIDE if name in INSERTIONS and name not in SUPERFICIAL else 0.0
    loose = 1.0 - glide if name in LOOSE else 0.0
    return replace(muscle, slack=TAUT.get(name, SLACK), glide=glide, loose=loose)


#: Columns through a muscle's thickness that are moved: across, along and through an element.
_COLUMNS = (5, 5, 3)
#: Widths (mm) of the means by which neighbours move along, in turn; and steps with each.
_WIDTHS, _STEPS = (3.0, 3.0, 2.0, 2.0, 1.5, 1.5, 1.5, 1.0, 1.0), 4
#: Share of its way by which a column goes back that has been taken along too far, and the smallest
#: scaled Jacobian; the first share with which the muscle keeps that is used.
_BACK, _LEAST_JACOBIAN = (0.1, 0.0), 0.08
#: Longest step (mm), and the weight of columns that are inside already.
_STRIDE, _AT_REST = 0.6, 0.5
#: Share of a muscle that may stay where it is when it is farther outside than the rest, and the
#: distance (mm) from which on it may.
_LEFT, _FAR = 0.03, 0.5
#: Weight of the change of first and second derivatives in the fit to the moved columns.
_STIFFNESS = 3e-3


def bring_inside(muscle: Muscle, tissue: HermiteMesh, above: float = -np.inf) -> Muscle:
    """Move the parts of a muscle that stand out of the tissue into it.

    The muscle flows: in small steps, every column of points through its thickness goes towards
    the nearest place that keeps its clearance, as the mean of its neighbours does, so that nothing
    folds. Columns keep their thickness, and grow thicker where the muscle has become shorter: its
    volume stays. The mesh is fitted to where they arrive, and what the fit has lost is sought
    again with narrower means.

    Parameters
    ----------
    muscle : Muscle
    tissue : HermiteMesh
    above : float
        What lies below this height (mm) stays where it is.
    """
    for back in _BACK:
        moved = _flow(muscle.mesh, tissue, above, back)
        if moved.scaled_jacobian(*_samples(moved)).min() > _LEAST_JACOBIAN:
            break
    return replace(muscle, mesh=moved)


def _samples(mesh: HermiteMesh) -> tuple[NDArray[np.int64], Array]:
    """Return the columns' points in every element."""
    ticks = [np.linspace(0.0, 1.0, n) for n in _COLUMNS]
    cell = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    elements = np.repeat(np.arange(mesh.n_elements), len(cell))
    return elements, np.tile(cell, (mesh.n_elements, 1))


def _flow(mesh: HermiteMesh, tissue: HermiteMesh, above: float, back: float) -> HermiteMesh:
    elements, xi = _samples(mesh)
    deep = _COLUMNS[2]
    shares = np.linalg.det(mesh.jacobian(elements, xi)).reshape(-1, deep).mean(axis=1)
    shares /= shares.sum()
    volume, growth = mesh.measures().sum(), 1.0
    columns = mesh.evaluate(elements, xi).reshape(-1, deep, 3)
    thickness = np.linalg.norm(columns[:, -1] - columns[:, 0], axis=1)
    start = columns.mean(axis=1)
    for number, width in enumerate(_WIDTHS):
        columns = mesh.evaluate(elements, xi).reshape(-1, deep, 3)
        if np.linalg.norm(_way_in(columns, tissue, above), axis=1).max() < 0.02:
            break
        growth = np.clip(growth * volume / mesh.measures().sum(), 1.0, 1.5)
        for _ in range(_STEPS):
            way = _way_in(columns, tissue, above)
            length = np.linalg.norm(way, axis=1)
            inside = length < 0.02
            if number < len(_WIDTHS) - 2:
                way[inside] = back * (start - columns.mean(axis=1))[inside]
            weight = np.where(inside, _AT_REST, 1.0)
            order = np.argsort(-length)
            last = order[np.cumsum(shares[order]) < _LEFT]
            weight[last[length[last] > _FAR]] = 0.0
            way *= np.minimum(1.0, _STRIDE / np.maximum(length, 1e-9))[:, None]
            points = columns.reshape(-1, 3)
            step = _mean_nearby(points, columns.mean(axis=1), way, weight, width)
            # What lies in the mid-plane stays there.
            step[:, 0] *= np.clip(0.5 * (points[:, 0] - MIDPLANE), 0.0, 1.0)
            columns = (points + step).reshape(-1, deep, 3)
            middle = columns.mean(axis=1, keepdims=True)
            present = np.linalg.norm(columns[:, -1] - columns[:, 0], axis=1)
            factor = np.clip(thickness * growth / np.maximum(present, 1e-9), 0.9, 1.1)
            columns = middle + factor[:, None, None] * (columns - middle)
        target = PointTarget("inside", elements, xi, columns.reshape(-1, 3))
        smoothing = Smoothing(first=_STIFFNESS, second=_STIFFNESS, relative=True)
        mesh = fit(mesh, [target], smoothing, iterations=1).mesh
    return mesh


def _way_in(columns: Array, tissue: HermiteMesh, above: float) -> Array:
    """Return the way (n, 3) of the worst point of columns (n, m, 3) to where it is clear."""
    points = columns.reshape(-1, 3)
    place = tissue.locate(points)
    ends = [np.column_stack([place.xi[:, :2], np.full(len(points), e)]) for e in (0.0, 1.0)]
    inner, outer = (tissue.evaluate(place.elements, end) for end in ends)
    depth = np.linalg.norm(outer - inner, axis=1)
    xi = place.xi.copy()
    xi[:, 2] = np.clip(xi[:, 2], CLEARANCE[1] / depth, 1.0 - CLEARANCE[0] / depth)
    # Off the margins of lips and lids.
    xi[:, 1] = np.where(place.inside, xi[:, 1], np.clip(xi[:, 1], 0.03, 0.97))
    way = tissue.evaluate(place.elements, xi) - points
    way[points[:, 2] < above] = 0.0
    way = way.reshape(columns.shape)
    worst = np.linalg.norm(way, axis=2).argmax(axis=1)
    return np.asarray(way[np.arange(len(way)), worst])


def _mean_nearby(at: Array, points: Array, values: Array, weight: Array, width: float) -> Array:
    """Return the weighted mean (n, 3) of values at points (m, 3) around each place (n, 3)."""
    near = cKDTree(at).sparse_distance_matrix(
        cKDTree(points), 3.0 * width, output_type="coo_matrix"
    )
    kernel = sp.csr_matrix(
        (np.exp(-0.5 * (near.data / width) ** 2), (near.row, near.col)), shape=near.shape
    )
    return np.asarray(
        (kernel @ (weight[:, None] * values)) / np.maximum(kernel @ weight, 1e-9)[:, None]
    )


def move_lids(muscle: Muscle, back: float = LID_SHIFT) -> Muscle:
    """Bring the lid part of orbicularis oculi from the source's lids to those of the head.

    Its outline as seen from the front stays.
    """
    return muscle.transformed(lambda points: points + np.array([0.0, back, 0.0]))


def inside_fraction(mesh: HermiteMesh, muscle: Muscle, above: float = -np.inf) -> float:
    """Return the share of a muscle's volume above a height that lies in the tissue."""
    rule = muscle.mesh.quadrature(3)
    points = muscle.mesh.evaluate(rule.elements, rule.xi)
    kept = points[:, 2] >= above
    if not kept.any():
        return 0.0
    inside = mesh.locate(points[kept]).inside
    return float(rule.weights[kept][inside].sum() / rule.weights[kept].sum())


#: Farther (mm) than this from a Gauss point none of its `cell_points` lies.
CELL = 4.0


def cell_points(elements: NDArray[np.int64], xi: Array) -> tuple[NDArray[np.int64], Array]:
    """Return 27 points in the cell of each of the Gauss points (n,), (n, 3) of elements.

    Their elements (27 n,) and coordinates (27 n, 3), those of a Gauss point together.
    """
    offsets = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1)
    around = np.clip(xi[:, None] + 0.08 * offsets.reshape(-1, 3), 0.0, 1.0)
    return np.repeat(elements, around.shape[1]), around.reshape(-1, 3)


def muscle_fraction(mesh: HermiteMesh, muscles: Iterable[Muscle]) -> Array:
    """Return the muscle volume fraction around the 4 x 4 x 4 Gauss points, (n_elements, 64).

    Each value is the share of 27 points of the Gauss point's cell that lie in a muscle.
    """
    elements, xi, _ = mesh.gauss_points(4)
    points = mesh.evaluate(*cell_points(elements, xi))
    covered = np.zeros(len(points), dtype=bool)
    for muscle in muscles:
        low, high = muscle.bounds()
        near = np.flatnonzero(~covered & (points > low).all(axis=1) & (points < high).all(axis=1))
        if len(near):
            covered[near] = muscle.mesh.locate(points[near], candidates=3).inside
    share = covered.reshape(len(elements), -1).mean(axis=1)
    return np.asarray(share.reshape(mesh.n_elements, -1))


def modiolus_share(mesh: HermiteMesh, centre: Array) -> Array:
    """Return the share of the modiolus at the Gauss points, (n_elements, 64)."""
    elements, xi, _ = mesh.gauss_points(4)
    distance = np.linalg.norm(mesh.evaluate(elements, xi) - centre, axis=1)
    share = smooth_step(1.5 - 1.5 * distance / MODIOLUS_RADIUS)
    return np.asarray(share.reshape(mesh.n_elements, -1))


def modiolus_centre(muscles: Mapping[str, Muscle], corner: Array) -> Array:
    """Return the place where the muscles of the corner of the mouth meet, (3,).

    The mean of their insertions and of the corner itself, which keeps the knot beside it.
    """
    ends = [muscles[name].insertion() for name in MODIOLAR if name in muscles]
    return np.asarray(0.5 * (np.mean(ends, axis=0) + corner))


def origins(
    mesh: HermiteMesh, muscles: Mapping[str, Muscle], fineness: int = 1
) -> dict[str, Attachment]:
    """Return the attachments of the muscles' bony ends, at points as of `Muscle.end_points`."""
    out: dict[str, Attachment] = {}
    for name, (stiffness, share) in ORIGINS.items():
        if name not in muscles:
            continue
        muscle = muscles[name]
        sides = (False, True) if muscle.kind == "ring" else (False,)
        ends = [muscle.end_points(share, side, fineness) for side in sides]
        points, volumes = (np.concatenate(part) for part in zip(*ends, strict=True))
        out[name] = _held(mesh, name, points, volumes, stiffness)
    return out


def _held(
    mesh: HermiteMesh, name: str, points: Array, volumes: Array, stiffness: float
) -> Attachment:
    """Share a stiffness among the points of a muscle that the tissue holds or nearly holds."""
    place = mesh.locate(points)
    near = place.distance < 1.0
    weight = volumes[near] / max(volumes[near].sum(), 1e-9)
    return Attachment(name, place.elements[near], place.xi[near], stiffness * weight)


#: Muscles that end in the skin or, beside the mouth, in the knot under it, and the stiffness
#: (mN/mm) of the fibrous bond between the last part of the muscle and the skin above it.
INSERTIONS: dict[str, float] = dict.fromkeys(
    (
        *("zygomaticus_major", "zygomaticus_minor", "risorius", "buccinator"),
        *("levator_labii_superioris", "levator_labii_superioris_alaeque_nasi"),
        *("levator_anguli_oris", "depressor_anguli_oris", "depressor_labii_inferioris"),
        *("mentalis", "platysma", "frontalis_medial", "frontalis_lateral"),
        *("corrugator_supercilii", "procerus", "nasalis", "depressor_septi_nasi"),
        "orbicularis_oculi_malar",
    ),
    875.0,
)
#: That part, as a share of the length: fibres leave a muscle for the skin long before its end, and
#: longer bonds reach measured faces better (`docs/scans.md`). They fan out on the way; what a bond
#: holds has this standard deviation (mm) in the plane of the skin.
INSERTION_SHARE, INSERTION_SPREAD = 0.35, 2.5


def insertions(
    mesh: HermiteMesh, muscles: Mapping[str, Muscle], fineness: int = 1
) -> dict[str, Attachment]:
    """Return the ends of the muscles that are bound to the skin above them, as `origins` does.

    The muscles of expression move the skin because their fibres end between those of the
    dermis; fat alone would let a deep end slip under it.
    """
    out: dict[str, Attachment] = {}
    for name, stiffness in INSERTIONS.items():
        if name in muscles:
            end = muscles[name].end_points(INSERTION_SHARE, True, fineness)
            out[name] = _fanned(mesh, _held(mesh, name, *end, stiffness))
    return out


def _fanned(mesh: HermiteMesh, bonds: Attachment) -> Attachment:
    """Put four points around each of some bonds in its place, along the skin.

    One that would leave the tissue, or be in an element that does not touch the bond's, such as
    beyond the mouth, stays in the middle.
    """
    tangents = mesh.jacobian(bonds.elements, bonds.xi)[:, :, :2]
    first, second = np.moveaxis(np.linalg.qr(tangents)[0], 2, 0)
    ways = INSERTION_SPREAD * np.array(
        [first + second, first - second, -first - second, second - first]
    )
    place = mesh.locate((mesh.evaluate(bonds.elements, bonds.xi) + ways).reshape(-1, 3))
    corners = mesh.corner_nodes()[0]
    home, own = np.tile(bonds.elements, 4), np.tile(bonds.xi, (4, 1))
    meet = (corners[home][:, :, None] == corners[place.elements][:, None, :]).any(axis=(1, 2))
    kept = (place.distance < 1.0) & meet
    return Attachment(
        bonds.name,
        np.where(kept, place.elements, home),
        np.where(kept[:, None], place.xi, own),
        np.tile(bonds.stiffness / 4.0, 4),
    )


#: Retaining ligaments: distances (mm) from the tragus and from the mid-plane or the corner of
#: the mouth at which they leave the bone, in a head of ordinary size. Zygomatic and mandibular
#: ligament; mental, medial mandibular and osteocutaneous ligament lateral of the mid-plane and
#: above the mandible's lower border.
LIGAMENTS: dict[str, dict[str, float]] = {
    "zygomatic_ligament": {"tragus": 66.5, "commissure": 56.3},
    "mandibular_ligament": {"tragus": 114.8, "above_border": 8.0},
    "mental_ligament": {"lateral": 9.1, "above_border": 8.4},
    "medial_mandibular_ligament": {"lateral": 28.5, "above_border": 8.4},
    "osteocutaneous_ligament": {"lateral": 51.1, "above_border": 9.1},
}
#: Size of this head relative to the adults that were measured (its similarity to the skin).
SIZE = 0.87
#: Stiffness (mN/mm) of a ligament and radius (mm) of the tissue that it holds.
LIGAMENT_STIFFNESS, LIGAMENT_RADIUS = 300.0, 5.0
#: The tragus, in front of the ear's canal (mm).
TRAGUS = (66.0, -107.0, 1514.0)


#: Deep fasciae over what the head has no surface for: rows and columns of the template, and the
#: stiffness (kPa/mm) with which the inner surface is tied to them. In front of the neck that is
#: what lies on hyoid and larynx; at its side skin and platysma lie loosely on the investing fascia
#: of the neck's muscles, with about the stiffness in shear of 6 mm of fat. Beside the forehead it
#: is the fascia of temporalis. Along its edge,
#: the temporal line, the layer is fixed to bone as well (Moss, Mendelson and Taylor 2000, Plast.
#: Reconstr. Surg. 105:1475-1490), which keeps frontalis from lifting the tail of the brow far.
#: Behind the cut through the scalp the galea goes on to occipitalis, which holds it: with this
#: stiffness what goes up and what comes down meet where they do in life.
FASCIAE: dict[str, tuple[tuple[int, int], tuple[int, int], float]] = {
    "infrahyoid_fascia": ((0, JAW_ROW), (0, 4), 2.0),
    "deep_cervical_fascia": ((0, JAW_ROW), (4, COLUMNS), 0.15),
    "temporal_fascia": ((13, 20), (8, COLUMNS), 1.0),
    "superior_temporal_septum": ((15, 20), (7, 8), 1.0),
    "galea": ((20, ROWS), (0, 9), 2.0),
}


def fasciae(mesh: HermiteMesh, inner: Side) -> dict[str, Attachment]:
    """Return the deep fasciae as springs on the inner surface."""
    every, axis, side = inner
    out: dict[str, Attachment] = {}
    for name, (rows, columns, stiffness) in FASCIAE.items():
        row, column = np.divmod(every, COLUMNS)
        part = (row >= rows[0]) & (row < rows[1]) & (column >= columns[0]) & (column < columns[1])
        face = mesh.face(every[part], axis, side)
        rule = face.quadrature(2)
        place = np.insert(rule.xi, axis, float(side), axis=1)
        out[name] = Attachment(name, every[part][rule.elements], place, stiffness * rule.weights)
    return out


#: Fibrous sheets by name: their parts in rows and columns of the template, and stiffness (mN/mm).
#: The superficial musculoaponeurotic system (SMAS), from the ear to the fold beside nose and mouth,
#: lies over the cheek, up to the cheekbone; below the mouth it goes on to the chin, as platysma
#: does. It thins out forward and is lost towards the middle of the face (Hu et al. 2014, Aesthet.
#: Surg. J. 34:661-667). Its collagen is crimped, and pulled it behaves like the skin before the ear
#: (Har-Shai et al. 1996, Plast. Reconstr. Surg. 98:59-70). The galea is an aponeurosis, from the
#: upper part of frontalis, which it encloses, up and back; ten times as stiff, it gives way so
#: little that the scalp moves in one piece.
SHEETS: dict[str, tuple[Sequence[tuple[tuple[int, int], tuple[int, int]]], float]] = {
    "smas": ([((3, 13), (FOLD_COLUMN, COLUMNS)), ((3, 5), (2, FOLD_COLUMN))], 400.0),
    "galea": ([((18, ROWS), (0, 9))], 4000.0),
}
#: Depth of the sheets below the skin (mm).
SHEET_DEPTH = 4.0


def sheets(mesh: HermiteMesh, outer: Side) -> dict[str, Attachment]:
    """Return the fibrous sheets of the tissue, by points that stand for an area of the skin."""
    every, axis, side = outer
    row, column = np.divmod(every, COLUMNS)
    out: dict[str, Attachment] = {}
    for name, (parts, stiffness) in SHEETS.items():
        part = np.zeros(len(every), dtype=bool)
        for (low, high), (first, last) in parts:
            part |= (row >= low) & (row < high) & (column >= first) & (column < last)
        rule = mesh.face(every[part], axis, side).quadrature(3)
        elements = every[part][rule.elements]
        ends = [np.insert(rule.xi, axis, end, axis=1) for end in (0.0, 1.0)]
        inner, skin = (mesh.evaluate(elements, end) for end in ends)
        place = ends[1]
        place[:, axis] -= np.minimum(SHEET_DEPTH / np.linalg.norm(skin - inner, axis=1), 0.95)
        out[name] = Attachment(name, elements, place, stiffness * rule.weights)
    return out


def ligaments(
    mesh: HermiteMesh, inner: Side, corner: Array, deep: Mapping[str, DistanceGrid]
) -> dict[str, Attachment]:
    """Return the retaining ligaments as springs on the inner surface.

    Parameters
    ----------
    mesh : HermiteMesh
        The tissue.
    inner : side
        Its inner surface.
    corner : (3,) array
        Corner of the mouth.
    deep : mapping of DistanceGrid
        With ``skull`` and ``mandible``.
    """
    elements, axis, side = inner
    face = mesh.face(elements, axis, side)
    local, xi, _ = face.gauss_points(4)
    points = face.evaluate(local, xi)
    jaw = deep["mandible"].sample(points).distance < 2.5
    border = points[jaw, 2].min()
    measured = {
        "tragus": np.linalg.norm(points - TRAGUS, axis=1),
        "commissure": np.linalg.norm(points - corner, axis=1),
        "lateral": points[:, 0] - MIDPLANE,
        "above_border": points[:, 2] - border,
    }
    out: dict[str, Attachment] = {}
    for name, places in LIGAMENTS.items():
        bone = "skull" if "commissure" in places else "mandible"
        miss = sum((measured[key] - SIZE * value) ** 2 for key, value in places.items())
        miss = np.where(deep[bone].sample(points).distance < 2.5, miss, np.inf)
        centre = points[np.argmin(miss)]
        held = np.linalg.norm(points - centre, axis=1) < LIGAMENT_RADIUS
        place = np.insert(xi[held], axis, float(side), axis=1)
        stiffness = np.full(int(held.sum()), LIGAMENT_STIFFNESS / held.sum())
        out[name] = Attachment(name, elements[local[held]], place, stiffness)
    return out
