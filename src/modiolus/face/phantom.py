"""A simulated T1-weighted image of a head, with the truth beside it.

The head is a face: its skin, the tissue behind it with the muscles, and the deep structures. What
lies behind is filled as far as the field of view reaches, so that the skin is closed in front and
the image open at the back, as one that a scanner's field of view cuts; before the skin, also where
it faces backwards, is air. Every voxel holds the mean of what is in it (partial volume): along y
exactly, across it from a finer grid of columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..anatomy.distance import distances_in_band
from ..anatomy.image import Image
from ..anatomy.surface import Surface
from ..fitting.register import rim_points
from ..hermite import HermiteMesh
from ..hermite.tessellate import tessellate
from .embed import boundary_surface
from .head import Head

__all__ = ["Phantom", "simulated_t1", "skin_error"]

Array = NDArray[np.float64]

#: Intensity of tissues in a T1-weighted image, relative to fat.
_FAT, _SKIN, _MUSCLE, _WITHIN = 1.0, 0.6, 0.42, 0.5
_DEEP = {
    "skull": 0.12,
    "mandible": 0.18,
    "teeth_upper": 0.05,
    "teeth_lower": 0.05,
    "gums_upper": 0.45,
    "gums_lower": 0.45,
    "masseter": 0.42,
    "cartilage": 0.35,
    "eyeball": 0.25,
}
#: Thickness of the dermis (mm).
_DERMIS = 1.5
#: Air before, beside and above the face, and what is shown behind it (mm).
_AIR, _BEHIND = 16.0, 30.0
#: Distance (mm) of the skin's free edges within which it tells nothing of what is before it.
_EDGE = 1.0
#: Columns across a voxel each way.
_COLUMNS = 4


@dataclass(frozen=True)
class Phantom:
    """A simulated image and what it was made of.

    Attributes
    ----------
    image : Image
        Intensities; fat is 1000 where there is neither noise nor shading.
    labels : Image
        The muscles: of each voxel the one that fills most of it, at least half.
    names : dict of str to int
        Their labels.
    skin : Surface
        The head's skin of both sides.
    muscles : dict of Surface
        The muscles of both sides.
    """

    image: Image
    labels: Image
    names: dict[str, int]
    skin: Surface
    muscles: dict[str, Surface]


def simulated_t1(
    head: Head, spacing: float = 1.0, noise: float = 0.02, bias: float = 0.3, seed: int = 0
) -> Phantom:
    """Simulate a T1-weighted image of a head.

    Parameters
    ----------
    head : Head
        One half; both sides are drawn.
    spacing : float
        Of the voxels (mm).
    noise : float
        Standard deviation of the noise in each of the two channels that make a magnitude,
        relative to fat: the air is Rayleigh, the tissue Rician.
    bias : float
        Largest deviation from 1 of a smooth factor over the image.
    seed : int
        Of the noise.

    Returns
    -------
    Phantom
    """
    half_skin = boundary_surface(head.tissue, head.sides["outer"], 8)
    low = half_skin.bounds[0] - [0.0, _AIR, 0.0]
    high = half_skin.bounds[1] + [_AIR, _BEHIND, _AIR]
    # The neck is cut by the field of view, the crown by the end of the skin.
    low[2] += 3.0
    shape = np.ceil((high - low) / spacing).astype(int)
    # The mid-plane lies between two voxels: one side is drawn, and the other is its mirror image.
    low[0] = head.midplane + 0.5 * spacing
    half = Image(np.zeros(shape, dtype=np.float32), low, spacing * np.eye(3), head.name)
    whole = Image(half.values, low - [shape[0] * spacing, 0.0, 0.0], half.axes, head.name)
    points = half.points(np.argwhere(np.ones(shape, dtype=bool)).astype(float))

    intensity = np.full(shape, _WITHIN)
    tissue = _hull(head.tissue, "tissue")
    within = _share(tissue, half, (slice(None),) * 3)
    inside = within > 0.0
    depth = half_skin.closest(points[inside.ravel()]).distance
    layer = _FAT + (_SKIN - _FAT) * np.clip((_DERMIS - depth) / spacing + 0.5, 0.0, 1.0)
    intensity[inside] += within[inside] * (layer - intensity[inside])
    labels = np.zeros(shape, dtype=np.int16)
    fullest = np.full(shape, 0.5)
    muscles = {name: _hull(muscle.mesh, name) for name, muscle in head.muscles.items()}
    for number, surface in enumerate(muscles.values(), start=1):
        ends = np.stack([half.indices(surface.bounds)[0] - 2, half.indices(surface.bounds)[1] + 3])
        ends = np.clip(np.round(ends), 0, shape).astype(int)
        box = tuple(slice(int(a), int(b)) for a, b in ends.T)
        if any(part.start >= part.stop for part in box):
            continue
        share = _share(surface, half, box)
        intensity[box] += share * (_MUSCLE - intensity[box])
        most = share > fullest[box]
        labels[box][most] = number
        fullest[box][most] = share[most]
    for name in head.deep:
        distance = head.distance(name).sample(points).distance.reshape(shape)
        share = np.clip(0.5 - distance / spacing, 0.0, 1.0)
        intensity += share * (_DEEP.get(name, _WITHIN) - intensity)
    filled = _filled(head, tissue, half)
    edge = (filled > 0.0) & (within < 1.0)
    behind = _behind(half_skin, head.midplane, points[edge.ravel()], spacing)
    filled[edge] = np.minimum(filled[edge], behind)
    intensity *= filled

    other = np.where(labels > 0, labels + len(muscles), 0)
    clean = np.concatenate([intensity[::-1], intensity])
    rng = np.random.default_rng(seed)
    channels = noise * rng.standard_normal((2, *clean.shape))
    channels[0] += clean * _shade(clean.shape, bias)
    sides = {"left": muscles, "right": {n: m.mirrored(head.midplane) for n, m in muscles.items()}}
    both = {f"{name}_{side}": item for side, part in sides.items() for name, item in part.items()}
    mirrored = half_skin.mirrored(head.midplane)
    return Phantom(
        whole.with_values((1000.0 * np.hypot(*channels)).astype(np.float32)),
        whole.with_values(np.concatenate([other[::-1], labels]).astype(np.int16)),
        {name: number for number, name in enumerate(both, start=1)},
        Surface.joined([half_skin, mirrored], "skin"),
        both,
    )


def skin_error(phantom: Phantom, surface: Surface, margin: float = 6.0) -> Array:
    """Return the distance (n,) in mm from the true skin to a surface found in its image.

    Parameters
    ----------
    phantom : Phantom
    surface : Surface
    margin : float
        Vertices nearer than this (mm) to a free edge of the skin do not count: there the head
        was closed without an example.
    """
    vertices = phantom.skin.vertices
    rim = _free_edges(phantom.skin, 0.5 * float(phantom.skin.bounds[:, 0].sum()))
    counts = (cKDTree(rim).query(vertices)[0] > margin) & phantom.image.shows(vertices)
    return surface.closest(vertices[counts]).distance


def _hull(mesh: HermiteMesh, name: str) -> Surface:
    """Return the closed surface of a volume mesh as triangles, turned outwards."""
    import pyvista as pv

    cut = tessellate(mesh, 6)
    cells = {pv.CellType.HEXAHEDRON: cut.cells}
    hull = pv.UnstructuredGrid(cells, cut.points(mesh.parameters)).extract_surface(algorithm=None)
    hull = hull.triangulate()
    surface = Surface(hull.points, hull.regular_faces, name)
    if surface.volume < 0.0:
        surface = Surface(surface.vertices, surface.faces[:, ::-1], name)
    return surface


def _share(surface: Surface, image: Image, box: tuple[slice, ...]) -> Array:
    """Return how much of each voxel in a part of an image a body fills."""
    spacing = float(image.spacing[0])
    shape = np.array(image.values[box].shape)
    low = image.points(np.array([[part.start or 0 for part in box]], dtype=float))[0]
    distance = distances_in_band(surface, low, spacing, shape, 2.0 * spacing)
    return np.asarray(np.clip(0.5 - distance / spacing, 0.0, 1.0))


def _filled(head: Head, tissue: Surface, image: Image) -> Array:
    """Return how much of each voxel is behind the front of tissue and eyeball."""
    eye = head.deep["eyeball"].distance.surface(closed=True) if "eyeball" in head.deep else tissue
    front = Surface.joined([tissue, eye])
    spacing = float(image.spacing[0])
    nx, ny, nz = image.values.shape
    y = image.origin[1] + spacing * (np.arange(ny) + 0.5)
    x, z = (image.origin[k] + spacing * np.arange(n) for k, n in ((0, nx), (2, nz)))
    out = np.zeros((nx, ny, nz))
    steps = spacing * ((np.arange(_COLUMNS) + 0.5) / _COLUMNS - 0.5)
    for dx in steps:
        for dz in steps:
            places = np.stack(np.meshgrid(x + dx, z + dz, indexing="ij"), axis=-1)
            origins = np.insert(places.reshape(-1, 2), 1, front.bounds[0, 1] - 1.0, axis=1)
            hits = front.first_hits(origins, np.array([0.0, 1.0, 0.0]))[:, 1]
            hits = np.where(np.isfinite(hits), hits, np.inf).reshape(nx, 1, nz)
            out += np.clip((y[None, :, None] - hits) / spacing, 0.0, 1.0)
    return out / _COLUMNS**2


def _behind(skin: Surface, plane: float, points: Array, spacing: float) -> Array:
    """Return how much of voxels around points (n, 3) is not before the skin.

    Under the chin and the jaw the skin faces backwards: there what a ray from the front has passed
    is air again. Beyond the free edges of the skin nothing is known of it.
    """
    rim = cKDTree(_free_edges(skin, plane))
    near = skin.closest(points)
    before = np.einsum("ni,ni->n", points - near.points, skin.normals[near.faces]) > 0.0
    before &= rim.query(near.points)[0] > _EDGE
    distance = np.where(before, near.distance, -np.inf)
    return np.asarray(np.clip(0.5 - distance / spacing, 0.0, 1.0))


def _free_edges(skin: Surface, plane: float) -> Array:
    """Return points of the free edges of a skin; in the mid-plane it goes on."""
    rim = rim_points(skin)
    return np.asarray(rim[np.abs(rim[:, 0] - plane) > 1e-3])


def _shade(shape: tuple[int, ...], bias: float) -> Array:
    """Return a smooth factor that runs from 1 - bias to 1 + bias over an image."""
    x, y, z = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij")
    wave = 0.5 * x - 0.6 * y + 0.7 * z + 0.5 * x * y - 0.4 * z**2
    return np.asarray(1.0 + bias * (2.0 * (wave - wave.min()) / np.ptp(wave) - 1.0))
