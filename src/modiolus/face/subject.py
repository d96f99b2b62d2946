"""A head of a person's own, from whatever surfaces there are.

Only the skin is required. A head that is there already is carried over to it
(`modiolus.face.morph`); muscles and deep structures that are given replace those carried over, and
where bones are given the inner surface of the tissue is laid on them. What each part of the head
comes from is written down in its provenance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ..anatomy.distance import DistanceGrid
from ..anatomy.surface import Surface, check_face
from ..errors import InputError
from ..fitting import PointTarget, Smoothing
from ..hermite import HermiteMesh, symmetry_plane
from ..hermite.basis import Array
from ..progress import Report
from .aligned import Aligned, align
from .deform import unfolded
from .embed import bring_inside, insertions, muscle_fraction, origins
from .gates import morph_quality, neck_height
from .head import Head, RigidSurface
from .morph import carried_head
from .moved import moved_head
from .muscle import Muscle
from .muscles import least_jacobian, outer_faces, outer_surface
from .provenance import GIVEN, INFERRED

__all__ = ["Structures", "build_subject", "sort_structures"]

#: Spacing (mm) of the samples of a given muscle, and the length (mm) by which two opposite unit
#: normals are apart: the two sides of a thin sheet are not taken for each other.
_SAMPLING, _TURN = 0.7, 4.0
#: Weights of the second derivatives of a muscle's change, and the distance (mm) of the farthest
#: match, from coarse to fine; each step begins where the last one ended.
_STEPS = ((100.0, 12.0), (10.0, 8.0), (1.0, 5.0), (0.3, 4.0), (0.1, 3.0), (0.03, 3.0))
#: Weight of the first derivatives relative to that: without it a muscle might shrink to nothing.
_FIRST = 0.1
#: Smallest scaled Jacobian with which a step of that is taken.
_LEAST_JACOBIAN = 0.05
#: Weight of a match along the surface relative to across it.
_SLIDING = 0.05
#: Up to this distance (mm) the inner surface is held to lie on a bone; elsewhere it keeps off.
_RESTING, _OFF = 3.0, 0.2
#: Weights of the second derivatives of the inner surface's change, from coarse to fine.
_LAYING = (1.0, 0.1, 1e-2, 1e-3, 1e-3)
#: Share of a surface's triangles on one side up to which it belongs to the other alone.
_SLIVER = 0.05
#: Room (mm) around a head's own deep structures in which given ones count.
_ROOM = 10.0


#: Surfaces of one structure: left, right, and those of which the name tells no side.
Sides = tuple[list[Surface], list[Surface], list[Surface]]


@dataclass(frozen=True)
class Structures:
    """The surfaces of a subject by what they are.

    Attributes
    ----------
    skin : Surface
    muscles, deep : dict of Sides
        By name those of the left side, those of the right side and those of no side.
    unused : list of str
        Names that the head does not know.
    """

    skin: Surface
    muscles: dict[str, Sides] = field(default_factory=dict)
    deep: dict[str, Sides] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)


def sort_structures(surfaces: Mapping[str, Surface], head: Head) -> Structures:
    """Sort named surfaces into skin, muscles and deep structures.

    Parameters
    ----------
    surfaces : mapping of str to Surface
        ``skin``, and names of the head's muscles and deep structures, with ``_left`` or
        ``_right`` or without a side.
    head : Head
        Its names are those that are understood.

    Raises
    ------
    InputError
        There is no skin.
    """
    if "skin" not in surfaces:
        names = ", ".join(surfaces) or "nothing"
        raise InputError(f"skin: not among the structures ({names}); it is the one required")
    muscles: dict[str, Sides] = {}
    deep: dict[str, Sides] = {}
    unused = []
    for name, surface in surfaces.items():
        plain, side = name, 2
        for number, ending in enumerate(("_left", "_right")):
            if name.endswith(ending):
                plain, side = name.removesuffix(ending), number
        for known, found in ((head.muscles, muscles), (head.deep, deep)):
            if plain in known:
                found.setdefault(plain, ([], [], []))[side].append(surface)
                break
        else:
            if name != "skin":
                unused.append(name)
    return Structures(surfaces["skin"], muscles, deep, unused)


def build_subject(
    head: Head,
    structures: Structures,
    landmarks: tuple[ArrayLike, ArrayLike] | None = None,
    report: Report | None = None,
    name: str = "subject",
) -> tuple[Head, dict[str, Any]]:
    """Make a head from the structures of a subject; what is missing is carried over from another.

    Parameters
    ----------
    head : Head
        A left half, from which the rest is carried over.
    structures : Structures
        In one frame of any pose, in mm, cm or m.
    landmarks : ((n, 3) array, (n, 3) array), optional
        Matched points of the skin, in its own frame, and of the head.
    report : callable, optional
        Told ``(fraction, message)`` as the work goes on.
    name : str
        Name of the new head.

    Returns
    -------
    head : Head
        In the frame of the old one and in the subject's size, with ``about["provenance"]``.
    quality : dict
        Figures of the fit as from `modiolus.face.gates.morph_quality`; ``given_rms_mm`` has the
        distance between each given muscle and its surface, both ways, and ``bone_rms_mm`` how far
        the inner surface is from where it should rest on given bones.

    Raises
    ------
    InputError
        Landmarks or surfaces are unusable.
    SolveError
        The skin does not meet the head.
    """
    tell = report or (lambda _fraction, _message: None)
    skin = structures.skin
    check_face(skin.name, skin.vertices[np.unique(skin.faces)])
    tell(0.0, "finding the pose of the skin")
    aligned = align(head, skin, landmarks)
    made, margins = carried_head(head, aligned, lambda share, what: tell(0.8 * share, what), name)
    figures: dict[str, Any] = {}
    if structures.deep:
        tell(0.75, "laying the tissue on the bones")
        bones = {
            key: _bone(sides, aligned, head.midplane) for key, sides in structures.deep.items()
        }
        tissue, figures["bone_rms_mm"] = lay_on(head, made.tissue, bones, aligned.size)
        made = moved_head(made, tissue.parameters)
        made = replace(made, deep=made.deep | _grids(head, bones, aligned))
    if structures.muscles:
        tell(0.8, "fitting the muscles that are given")
        made, figures["given_rms_mm"] = _with_muscles(made, structures, aligned)
    tell(0.9, "quality")
    quality = morph_quality(head, made, aligned, margins) | figures
    made.about["provenance"] = provenance(head, structures)
    tell(1.0, "done")
    return made, quality


def _with_muscles(
    made: Head, structures: Structures, aligned: Aligned
) -> tuple[Head, dict[str, float]]:
    """Fit the muscles that are given, and renew what depends on where they are."""
    cut = neck_height(made)
    plane = made.midplane
    fitted, rms = {}, {}
    for key, sides in structures.muscles.items():
        left, right, both = ([aligned.pose.moved(s) for s in side] for side in sides)
        surfaces = one_side(left, right, both, plane)
        muscle = fit_muscle(made.muscles[key], surfaces, plane)
        rms[key] = round(_distance(muscle, surfaces), 3)
        fitted[key] = bring_inside(muscle, made.tissue, cut)
    muscles = made.muscles | fitted
    # Only where a given muscle is now, or was before, its share of the tissue changes.
    changed = [made.muscles[key] for key in fitted] + list(fitted.values())
    near = _meeting(made.tissue, [muscle.bounds() for muscle in changed])
    fraction = made.fraction.copy()
    fraction[near] = muscle_fraction(made.tissue.subset(near), muscles.values())
    return replace(
        made,
        muscles=muscles,
        fraction=fraction,
        attachments=made.attachments | origins(made.tissue, fitted),
        insertions=made.insertions | insertions(made.tissue, fitted),
    ), rms


def _meeting(tissue: HermiteMesh, boxes: Sequence[Array]) -> NDArray[np.int64]:
    """Return the elements whose own box meets one of some boxes (2, 3)."""
    ticks = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 4)] * 3), axis=-1).reshape(-1, 3)
    every = np.arange(tissue.n_elements)
    points = tissue.evaluate(np.repeat(every, len(ticks)), np.tile(ticks, (len(every), 1)))
    points = points.reshape(len(every), -1, 3)
    low, high = points.min(axis=1) - 1.0, points.max(axis=1) + 1.0
    meets = [((low <= box[1]) & (high >= box[0])).all(axis=1) for box in boxes]
    return np.flatnonzero(np.any(meets, axis=0))


def one_side(
    left: Sequence[Surface], right: Sequence[Surface], both: Sequence[Surface], plane: float
) -> list[Surface]:
    """Return surfaces as they are on the left side, those of the right side mirrored."""
    out = [*left, *(surface.mirrored(plane) for surface in right)]
    for surface in both:
        here = surface.vertices[surface.faces].mean(axis=1)[:, 0] >= plane
        if here.mean() > _SLIVER:
            out.append(surface.picked(surface.faces[here]))
        if here.mean() < 1.0 - _SLIVER:
            out.append(surface.picked(surface.faces[~here]).mirrored(plane))
    return out


def _bone(sides: Sides, aligned: Aligned, plane: float) -> Surface:
    """Return a deep structure in the head's frame: all that is given of it."""
    left, right, both = sides
    parts = [aligned.pose.moved(surface) for surface in [*left, *right, *both]]
    if right and not left and not both:
        # The head is a left half; what is known of the right side only is mirrored.
        parts = [part.mirrored(plane) for part in parts]
    return Surface.joined(parts, parts[0].name)


def _grids(head: Head, bones: Mapping[str, Surface], aligned: Aligned) -> dict[str, RigidSurface]:
    """Return the distances to given bones in the region of the head's own deep structures."""
    bounds = np.array([item.distance.bounds for item in head.deep.values()])
    box = np.stack([bounds[:, 0].min(axis=0) - _ROOM, bounds[:, 1].max(axis=0) + _ROOM])
    box = aligned.grown(box)
    box[0, 0] = head.midplane - _ROOM
    return {
        key: RigidSurface(
            key, DistanceGrid.of([bone], head.deep[key].distance.spacing * aligned.size, box)
        )
        for key, bone in bones.items()
    }


def fit_muscle(muscle: Muscle, surfaces: Sequence[Surface], plane: float) -> Muscle:
    """Fit a muscle that has been carried over to its own surfaces.

    Samples of either are matched with the nearest of the other, in position and normal. The
    muscle's coordinates, and with them its fibres, deform as little as the surfaces allow.

    Parameters
    ----------
    muscle : Muscle
    surfaces : sequence of Surface
        Of this side, or mirrored to it (mm).
    plane : float
        x of the mid-plane: what lies in it stays there.
    """
    mesh = muscle.mesh
    faces = outer_faces(mesh)
    held = np.zeros((mesh.n_params, 3), dtype=bool)
    skin, outward = mesh.boundary([([e], axis, side) for e, axis, side in faces])
    local, flat, _ = skin.gauss_points(4)
    elements = np.array([face[0] for face in faces])[local]
    xi = np.stack(
        [np.insert(x, faces[f][1], faces[f][2]) for f, x in zip(local, flat, strict=True)]
    )
    points = skin.evaluate(local, flat)
    for number, (element, axis, side) in enumerate(faces):
        if np.abs(points[local == number, 0] - plane).max() < 0.05:
            held |= symmetry_plane(mesh, np.array([element]), axis, side)
    data = [_samples(surface) for surface in surfaces]
    for stiffness, reach in _STEPS:
        current = replace(skin, parameters=mesh.parameters)
        points = current.evaluate(local, flat)
        tangents = current.jacobian(local, flat)
        normals = outward[local][:, None] * np.cross(tangents[:, :, 0], tangents[:, :, 1])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        own = np.hstack([points, 0.5 * _TURN * normals])
        tree = cKDTree(own)
        targets = []
        for samples, facing, known in data:
            far, index = known.query(own)
            here = np.flatnonzero(far < reach)
            far, back = tree.query(np.hstack([samples, 0.5 * _TURN * facing]))
            near = far < reach
            # Both directions weigh the same, however many samples a surface has.
            for at, there, share in (
                (here, samples[index[here]], 1.0),
                (back[near], samples[near], len(own) / len(samples)),
            ):
                weight = share / len(data)
                place = elements[at], xi[at], there
                targets.append(PointTarget("given", *place, weight, normals[at], _SLIDING))
        smoothing = Smoothing(first=_FIRST * stiffness, second=stiffness, relative=True)
        finer = unfolded(mesh, targets, smoothing, held)[0]
        if not least_jacobian(finer) > _LEAST_JACOBIAN:
            break
        mesh = finer
    return replace(muscle, mesh=mesh)


def _samples(surface: Surface) -> tuple[Array, Array, cKDTree]:
    """Return points spread over a surface, its outward normals there, and a tree of both."""
    if surface.volume < 0.0:
        surface = Surface(surface.vertices, surface.faces[:, ::-1], surface.name)
    points = surface.samples(_SAMPLING)
    facing = surface.normals[surface.closest(points).faces]
    return points, facing, cKDTree(np.hstack([points, 0.5 * _TURN * facing]))


def _distance(muscle: Muscle, surfaces: Sequence[Surface]) -> float:
    """Return the root mean square distance (mm) between a muscle and its surfaces, both ways."""
    own = outer_surface(muscle)
    gaps = []
    for surface in surfaces:
        gaps += [
            surface.closest(own.samples(0.7)).distance,
            own.closest(surface.samples(0.7)).distance,
        ]
    return float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)))


def lay_on(
    head: Head, tissue: HermiteMesh, bones: Mapping[str, Surface], size: float
) -> tuple[HermiteMesh, float]:
    """Lay the inner surface of a carried tissue on bones that are given; the skin stays.

    Where the head's own inner surface rests on these bones (within 3 mm) it comes to lie as far
    from the given ones, in the new size; elsewhere it only keeps off them.

    Parameters
    ----------
    head : Head
        From which the tissue was carried over.
    tissue : HermiteMesh
    bones : mapping of str to Surface
        By names of the head's deep structures (mm).
    size : float
        Of the new head relative to the old.

    Returns
    -------
    tissue : HermiteMesh
    rms : float
        Root mean square difference (mm) between wanted and reached distance where it rests.
    """
    elements, axis, side = head.sides["inner"]
    local, xi, _ = head.tissue.face(elements, axis, side).gauss_points(4)
    at = elements[local], np.insert(xi, axis, float(side), axis=1)
    rest = head.tissue.evaluate(*at)
    wanted = size * np.min([head.deep[key].distance.sample(rest).distance for key in bones], axis=0)
    resting = wanted < _RESTING
    whole = Surface.joined(bones.values())
    held = symmetry_plane(head.tissue, *head.sides["midplane"])
    for name in ("outer", "lip_upper", "lip_lower"):
        held[tissue.face_parameters(*head.sides[name])[0]] = True
    mesh = tissue
    for weight in _LAYING:
        points = mesh.evaluate(*at)
        distance, gradient = _off(whole, points)
        lack = np.where(resting, wanted - distance, np.maximum(_OFF - distance, 0.0))
        counts = resting | (lack > 0.0)
        target = PointTarget(
            "bones",
            at[0][counts],
            at[1][counts],
            (points + lack[:, None] * gradient)[counts],
            normals=gradient[counts],
            sliding=0.05,
        )
        smoothing = Smoothing(first=0.1 * weight, second=weight, relative=True)
        mesh = unfolded(tissue, [target], smoothing, held)[0]
    gap = _off(whole, mesh.evaluate(*at))[0][resting] - wanted[resting]
    return mesh, round(float(np.sqrt(np.mean(gap**2))), 3) if resting.any() else 0.0


def _off(surface: Surface, points: Array) -> tuple[Array, Array]:
    """Return signed distance (n,) of points to a closed surface and its gradient (n, 3)."""
    near = surface.closest(points)
    sign = np.where(surface.contains(points), -1.0, 1.0)
    gradient = sign[:, None] * (points - near.points) / np.maximum(near.distance, 1e-9)[:, None]
    # On the surface itself its normal is the safer direction.
    touching = near.distance < 0.1
    gradient[touching] = surface.normals[near.faces[touching]]
    return sign * near.distance, gradient


def provenance(head: Head, structures: Structures) -> dict[str, str]:
    """Return for each part of a head what it comes from: ``given`` or ``inferred``, and how."""
    carried = f"{INFERRED}: carried over from {head.name} by morphing"

    def source(sides: Sequence[Sequence[Surface]]) -> str:
        return f"{GIVEN}: " + ", ".join(surface.name for side in sides for surface in side)

    bones = ", ".join(structures.deep)
    depth = f"{INFERRED}: the depth of {head.name}'s layer in the size of the face"
    out = {
        "skin": f"{GIVEN}: {structures.skin.name}",
        "inner_surface": f"{GIVEN}: on {bones}; elsewhere {depth}" if bones else depth,
    }
    for names, given in ((head.muscles, structures.muscles), (head.deep, structures.deep)):
        for key in names:
            out[key] = source(given[key]) if key in given else carried
    out["attachments"] = f"{INFERRED}: places of {head.name}'s, of given muscles at their ends"
    return out
