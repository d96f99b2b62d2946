"""The skin of a head in a T1-weighted magnetic resonance image.

Air is dark and tissue is not; what stands between this and a surface are shading by the coil,
noise, ghosts of the moving eyes and neck, and air inside the head. The steps are

1. the shading is divided out (N4 [Tustison2010]_, at a coarse resolution);
2. Otsu's threshold on the logarithm of the image [Otsu1979]_ tells noise from tissue, and the head
   begins at a third of the step between the two;
3. the largest connected body is the head. Air that a ball cannot reach from outside is within it,
   so that nostrils and ear canals end in a lid a few millimetres deep;
4. along the skin the level is half way between the tissue beneath and the air before it, both as
   local means: half of an edge's height is where the edge is, whatever blurs it;
5. flying edges put the surface where the smoothed image crosses that level, between the voxels;
6. the dermis is darker than the fat beneath it, so that this level is crossed too deep: profiles of
   two layers across the skin put it right where the image is sharp enough to show them.

References
----------
.. [Tustison2010] N. J. Tustison et al., "N4ITK: improved N3 bias correction", IEEE Trans.
   Med. Imaging 29 (2010) 1310-1320.
.. [Otsu1979] N. Otsu, "A threshold selection method from gray-level histograms", IEEE Trans.
   Syst. Man Cybern. 9 (1979) 62-66.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.special import ndtr

from modiolus.anatomy.image import Image, simpleitk
from modiolus.anatomy.surface import Surface
from modiolus.errors import InputError
from modiolus.hermite.basis import smooth_step
from modiolus.progress import Report

__all__ = ["Segmentation", "isosurface", "outer_skin", "segment_skin"]

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Voxels are averaged to about this size (mm) where they are smaller: no skin is known better.
_FINEST = 0.7
#: Spacing (mm) at which the head is found first, the share of the step from noise to tissue at
#: which it begins, and how often the level is then adapted. A low share would let ghosts in.
_COARSE, _FIRST, _ROUNDS = 2.0, 0.35, 3
#: Spacing (mm) at which the shading is estimated, and how often each of its levels is refined.
_BIAS_SPACING, _BIAS_ITERATIONS = 4.0, (30, 30, 20)
#: Radius (mm) of the ball that finds what is outside, and how deep recesses narrower than it go.
_BALL, _RECESS = 6.0, 4.0
#: Radius (mm) of the opening that cuts ghosts and coils off the head, and the distance from what is
#: left up to which thin skin, as that over bone, still belongs to it.
_BRIDGE, _SHEET = 1.5, 10.0
#: Depths (mm) between which tissue, at last only its outermost part (mm or voxels, whichever is
#: more), and air are measured, and the width of the local means.
_TISSUE, _DERMIS, _AIR, _LOCAL = (1.0, 4.0), (1.2, 2.3), (3.0, 7.0), 6.0
#: Standard deviation (mm) of the smoothing before the surface, at least and in voxels.
_SMOOTH, _SMOOTH_VOXELS = 0.5, 0.5
#: Distance (mm) from the skin beyond which the image no longer decides.
_BAND = 3.0
#: Thickness (mm) of the dermis of a face, and the least share of the fat's signal that it has.
_LAYER, _DARKEST = 1.5, 0.35
#: Depths (mm) at which profiles are taken, trial places of the skin in them, and trial widths of
#: its edge: standard deviations (mm) of what blurs it.
_DEPTHS, _PLACES = np.arange(-3.0, 3.51, 0.25), np.arange(-1.25, 1.26, 0.125)
_WIDTHS = (0.4, 0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0)
#: Widths of the edge up to which the dermis shows, and from which on it does not.
_SHOWN, _HIDDEN = 0.9, 1.5
#: Every how manieth profile tells the width, how many neighbours are fitted together, and how far
#: (mm) the skin goes from its usual correction.
_SPARSE, _NEIGHBOURS, _AWAY = 17, 30, 0.25
#: Share of the profiles that fit best; the others get the usual correction.
_SOUND = 0.85
#: Volume (litres) and extent (mm) of what a field of view may show of a head.
_VOLUMES, _EXTENTS = (0.3, 9.0), (90.0, 420.0)
#: Contrast of tissue to noise below which there is nothing to segment.
_LEAST_CONTRAST = 4.0
#: Names of the ends of the axes, as a person would call them.
_ENDS = (("right", "left"), ("front", "back"), ("bottom", "top"))


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The skin in an image, and what it was found from.

    Attributes
    ----------
    surface : Surface
        The skin (mm, LPS), open where the field of view ends.
    image : Image
        The image without its shading, at the resolution that was used.
    mask : (nx, ny, nz) bool array
        The head in that image, air inside it counted in.
    air, tissue : float
        Intensities of noise and of the tissue beneath the skin.
    noise : float
        Standard deviation of the noise.
    cuts : dict of str to float
        Area (mm²) of the head on each side of the field of view where it goes on beyond.
    """

    surface: Surface
    image: Image
    mask: Bools
    air: float
    tissue: float
    noise: float
    cuts: dict[str, float]

    @property
    def volume(self) -> float:
        """Volume of the head in the field of view (litres)."""
        return float(self.mask.sum()) * self.image.voxel_volume * 1e-6


def segment_skin(image: Image, tell: Report | None = None) -> Segmentation:
    """Find the skin of a head in a T1-weighted image.

    Parameters
    ----------
    image : Image
    tell : callable, optional
        Told ``(share, message)`` as the work goes on.

    Returns
    -------
    Segmentation

    Raises
    ------
    InputError
        There is no contrast in the image, or what it shows has not the size of a head.
    """
    tell = tell or (lambda _share, _message: None)
    tell(0.0, "shading")
    image = image.reduced(_factors(image, _FINEST))
    values = image.values - np.float32(min(float(image.values.min()), 0.0))
    values = values / _shading(image, values, _threshold(image.name, values))
    tell(0.4, "head against air")
    factors = _factors(image, _COARSE)
    coarse = image.with_values(values).reduced(factors)
    bright = coarse.values > _threshold(image.name, coarse.values)
    low, high = np.median(coarse.values[~bright]), np.median(coarse.values[bright])
    head = _head(coarse, coarse.values > low + _FIRST * (high - low))
    for _ in range(_ROUNDS):
        head = _head(coarse, _relative(coarse, coarse.values, head) > 0.0, near=head)
    tell(0.6, "local level")
    head = _enlarged(head.astype(np.float32), factors, values.shape) > 0.5
    smooth = _smoothed(image, values)
    voxel = max(1.0, float(image.spacing.max()))
    relative = _relative(image, smooth, head, (_DERMIS[0] * voxel, _DERMIS[1] * voxel))
    head = _head(image, relative > 0.0, near=head)
    air, noise = _air(image, values, head)
    inside = head & (_depth(image, head) < _TISSUE[1])
    tissue = float(np.median(values[inside])) if inside.any() else 0.0
    if tissue - air < _LEAST_CONTRAST * noise:
        raise InputError(
            f"{image.name}: tissue hardly differs from noise; give a T1-weighted image of a head"
        )
    tell(0.8, "surface")
    surface = isosurface(image, _field(image, relative, head), 0.0).largest_component()
    surface = outer_skin(image.with_values(values), surface, air)
    out = Segmentation(
        Surface(surface.vertices, surface.faces, "skin"),
        image.with_values(values),
        head,
        air,
        tissue,
        noise,
        _cuts(image, head),
    )
    extent = np.ptp(surface.bounds, axis=0)
    if not (
        _VOLUMES[0] <= out.volume <= _VOLUMES[1]
        and _EXTENTS[0] <= extent.min()
        and extent.max() <= _EXTENTS[1]
    ):
        size = " × ".join(f"{length:.0f}" for length in extent)
        raise InputError(
            f"{image.name}: what it shows, {size} mm and {out.volume:.1f} l, is no head; "
            "give a T1-weighted image of a whole head"
        )
    return out


def isosurface(image: Image, values: NDArray[Any], level: float) -> Surface:
    """Triangulate where values on an image's grid cross a level, larger values inside.

    Parameters
    ----------
    image : Image
        Whose grid it is.
    values : (nx, ny, nz) array
    level : float

    Raises
    ------
    InputError
        The level is not crossed.
    """
    import pyvista as pv

    grid = pv.ImageData(dimensions=values.shape)
    grid["value"] = np.asarray(values, dtype=np.float32).ravel(order="F")
    mesh = grid.contour([level], scalars="value", method="flying_edges", compute_normals=False)
    if not mesh.n_cells:
        raise InputError(f"{image.name}: no surface in it; give an image of a head")
    faces = mesh.regular_faces
    # Flying edges turns its triangles towards smaller values: outwards, unless the axes mirror.
    if np.linalg.det(image.axes) < 0.0:
        faces = faces[:, ::-1]
    return Surface(image.points(np.asarray(mesh.points, dtype=float)), faces, image.name)


def _threshold(name: str, values: Floats) -> float:
    """Return Otsu's threshold between noise and tissue, on the logarithm of the values."""
    high = float(np.percentile(values[::2, ::2, ::2], 98.0))
    if not high > 0.0:
        raise InputError(f"{name}: no contrast in it; give a T1-weighted image of a head")
    floor = 0.02 * high
    logs = np.log1p(np.minimum(values[::2, ::2, ::2], high) / floor)
    counts, edges = np.histogram(logs, 256)
    middle = 0.5 * (edges[1:] + edges[:-1])
    below = np.cumsum(counts)
    above = below[-1] - below
    mass = np.cumsum(counts * middle)
    with np.errstate(invalid="ignore", divide="ignore"):
        between = below * above * (mass / below - (mass[-1] - mass) / above) ** 2
    if not np.nanmax(between) > 0.0:
        raise InputError(f"{name}: no contrast in it; give a T1-weighted image of a head")
    return floor * float(np.expm1(middle[int(np.nanargmax(between))]))


def _shading(image: Image, values: Floats, threshold: float) -> Floats:
    """Return the slowly varying factor by which the coil brightens the image, about 1."""
    sitk = simpleitk()
    factors = _factors(image, _BIAS_SPACING)
    coarse = image.with_values(values).reduced(factors)
    mask = coarse.values > threshold
    if mask.sum() < 1000:
        return np.ones_like(values)
    # N4 works on the logarithm: noise around the head must not count.
    picture, where = (
        sitk.GetImageFromArray(np.ascontiguousarray(array.transpose(2, 1, 0)))
        for array in (np.maximum(coarse.values, 1e-3 * threshold), mask.astype(np.uint8))
    )
    for item in (picture, where):
        item.SetSpacing(coarse.spacing.tolist())
    corrector = sitk.N4BiasFieldCorrectionImageFilter()
    corrector.SetMaximumNumberOfIterations(_BIAS_ITERATIONS)
    corrector.Execute(picture, where)
    field = np.exp(sitk.GetArrayFromImage(corrector.GetLogBiasFieldAsImage(picture)))
    field = field.transpose(2, 1, 0).astype(np.float32)
    # Beyond the head the splines are free: there the factor is that of the nearest tissue.
    nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    field = field[tuple(nearest)]
    field = ndimage.gaussian_filter(field / np.median(field[mask]), 1.0)
    return np.clip(_enlarged(field, factors, values.shape), 0.1, 10.0)


def _factors(image: Image, spacing: float) -> NDArray[np.int64]:
    """Return the blocks of voxels that make an image about as coarse as a spacing (mm)."""
    return np.maximum(np.round(spacing / image.spacing), 1.0).astype(np.int64)


def _enlarged(coarse: Floats, factors: NDArray[np.int64], shape: tuple[int, ...]) -> Floats:
    """Interpolate the means of blocks linearly back to the voxels they came from."""
    out = coarse
    for axis in range(3):
        at = (np.arange(shape[axis]) - 0.5 * (factors[axis] - 1.0)) / factors[axis]
        at = np.clip(at, 0.0, out.shape[axis] - 1.0)
        low = np.minimum(at.astype(np.int64), out.shape[axis] - 2)
        share = (at - low).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        out = np.take(out, low, axis) * (1.0 - share) + np.take(out, low + 1, axis) * share
    return out


def _smoothed(image: Image, values: Floats) -> Floats:
    sigma = np.maximum(_SMOOTH / image.spacing, _SMOOTH_VOXELS)
    return np.asarray(ndimage.gaussian_filter(values, sigma, mode="nearest"))


def _depth(image: Image, body: Bools) -> Floats:
    """Return the distance (mm) of voxels within a body to the nearest one that is not."""
    if body.all():
        return np.full(body.shape, np.inf, dtype=np.float32)
    sitk = simpleitk()
    picture = sitk.GetImageFromArray(
        np.ascontiguousarray((~body).transpose(2, 1, 0)).view(np.uint8)
    )
    picture.SetSpacing(image.spacing.tolist())
    distance = sitk.SignedMaurerDistanceMap(picture, squaredDistance=False, useImageSpacing=True)
    return np.asarray(np.maximum(sitk.GetArrayFromImage(distance).transpose(2, 1, 0), 0.0))


def _largest(body: Bools) -> Bools:
    labels, count = ndimage.label(body)
    if count == 0:
        return body
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(labels == int(np.argmax(sizes)))


def _head(image: Image, bright: Bools, near: Bools | None = None) -> Bools:
    """Return the head: the largest body with all that is not outside of it.

    Parameters
    ----------
    image : Image
    bright : (nx, ny, nz) bool array
        Voxels of tissue, ghosts and the like.
    near : (nx, ny, nz) bool array, optional
        An earlier head; what is farther from it than the recesses are deep is no part of the new.
    """
    if near is not None:
        bright = bright & (_depth(image, ~near) <= _RECESS)
    # Opening cuts bridges; what it took off the head itself lies next to what is left.
    core = _largest(_depth(image, bright) > _BRIDGE)
    body = _largest(bright & (_depth(image, ~core) <= _SHEET))
    if not body.any():
        raise InputError(f"{image.name}: nothing in it stands out; give an image of a head")
    # Closing by a ball: where the ball passes is outside.
    grown = _depth(image, ~body) <= _BALL
    closed = _depth(image, grown) > _BALL
    free, count = ndimage.label(~closed)
    doors = np.zeros(count + 1, dtype=bool)
    for axis in range(3):
        for end in (0, -1):
            # Where the field of view cuts the head, windpipe and sinuses are no way out.
            section = np.take(closed, end, axis)
            way = ~ndimage.binary_fill_holes(section)
            doors[np.take(free, end, axis)[way]] = True
    doors[0] = False
    outside = doors[free]
    # Recesses too narrow for the ball are outside to some depth, if one can get there.
    reach = ~body & (_depth(image, ~outside) <= _RECESS)
    parts, _ = ndimage.label(reach)
    open_parts = np.unique(parts[outside])
    return ~np.isin(parts, open_parts[open_parts > 0])


def _local_mean(image: Image, values: Floats, where: Bools, otherwise: float) -> Floats:
    """Return the mean of values over a region, weighted by nearness."""
    sigma = _LOCAL / image.spacing
    weight = ndimage.gaussian_filter(where.astype(np.float32), sigma, truncate=3.0)
    total = ndimage.gaussian_filter(np.where(where, values, 0.0), sigma, truncate=3.0)
    return np.asarray((total + 1e-3 * otherwise) / (weight + 1e-3), dtype=np.float32)


def _relative(
    image: Image, smooth: Floats, head: Bools, depths: tuple[float, float] = _TISSUE
) -> Floats:
    """Return the image relative to local air and tissue: -1/2 in air, 1/2 in tissue."""
    below, above = _depth(image, head), _depth(image, ~head)
    # The outermost voxels are filled in part, and far beneath the dermis fat is brighter than it.
    shell = (below > depths[0]) & (below < depths[1])
    around = (above > _AIR[0]) & (above < _AIR[1])
    if not (shell.any() and around.any()):
        raise InputError(f"{image.name}: no air around a head in it; give a whole head")
    tissue = _local_mean(image, smooth, shell, float(np.median(smooth[shell])))
    air = _local_mean(image, smooth, around, float(np.median(smooth[around])))
    return np.asarray((smooth - air) / np.maximum(tissue - air, 1e-3 * tissue + 1e-6) - 0.5)


def _field(image: Image, relative: Floats, head: Bools) -> Floats:
    """Return what has its zero on the skin: the image there, the head's mask elsewhere.

    The two differ where a nostril has its lid, inside the head and in ghosts.
    """
    below, above = _depth(image, head), _depth(image, ~head)
    soft = ndimage.gaussian_filter(head.astype(np.float32), 1.0 / image.spacing) - 0.5
    lid = head & (relative <= 0.0)
    ghost = ~head & (relative > 0.0)
    step = 1.8 * float(image.spacing.max())
    field = np.where(_depth(image, ~lid) <= step, np.maximum(relative, soft), relative)
    field = np.where(_depth(image, ~ghost) <= step, np.minimum(field, soft), field)
    field[below > _BAND] = np.maximum(field[below > _BAND], 0.5)
    field[above > _BAND] = np.minimum(field[above > _BAND], -0.5)
    return np.asarray(field, dtype=np.float32)


def outer_skin(image: Image, surface: Surface, air: float) -> Surface:
    """Move the skin to where profiles of two layers, a darker one upon a brighter, begin.

    Parameters
    ----------
    image : Image
        Without its shading.
    surface : Surface
        Where the level is half way.
    air : float
        Intensity of the noise.

    Returns
    -------
    Surface

    Notes
    -----
    A profile across the skin is ``A + (D - A) Φ((t - t0) / s) + (F - D) Φ((t - t0 - w) / s)`` with
    the depth ``t``, the signals of air, dermis and fat, the dermis' thickness ``w``, and the
    integral ``Φ`` of the normal distribution: linear but for the place ``t0`` and the width ``s``
    of the edge, which are tried out. The width is that of the whole image. Where it is as much as
    the dermis is thick the two layers cannot be told apart, and nothing is moved.
    """
    inward = -surface.vertex_normals
    places = surface.vertices[:, None] + _DEPTHS[:, None] * inward[:, None]
    indices = image.indices(places.reshape(-1, 3)).T
    profiles = ndimage.map_coordinates(image.values, indices, order=1, mode="nearest")
    profiles = profiles.reshape(len(inward), len(_DEPTHS)).astype(np.float64)
    few = profiles[::_SPARSE]
    width = min(_WIDTHS, key=lambda s: float(np.median(_misfits(few, s, air).min(axis=0))))
    share = float(smooth_step((_HIDDEN - width) / (_HIDDEN - _SHOWN)))
    if share == 0.0:
        return surface
    near = cKDTree(surface.vertices).query(surface.vertices, k=_NEIGHBOURS)[1]
    misfits = np.stack([row[near].mean(axis=1) for row in _misfits(profiles, width, air)])
    best = np.clip(misfits.argmin(axis=0), 1, len(_PLACES) - 2)
    a, b, c = (misfits[best + k, np.arange(len(best))] for k in (-1, 0, 1))
    finer = np.clip(0.5 * (a - c) / np.maximum(a - 2.0 * b + c, 1e-9), -1.0, 1.0)
    place = _PLACES[best] + (_PLACES[1] - _PLACES[0]) * finer
    # Beside bone, cartilage and folds the profile is another one.
    usual = float(np.median(place))
    relative = b / np.maximum(np.ptp(profiles, axis=1)[near].mean(axis=1), 1e-9) ** 2
    sound = (relative < np.quantile(relative, _SOUND)) & (np.abs(place - usual) < 2.0 * _AWAY)
    place = np.clip(np.where(sound, place, usual), usual - _AWAY, usual + _AWAY)
    move = share * place[near].mean(axis=1)
    return Surface(surface.vertices + move[:, None] * inward, surface.faces, surface.name)


def _misfits(profiles: Doubles, width: float, air: float) -> Doubles:
    """Return the squared misfit of profiles (n, m) for each trial place, (n_places, n)."""
    out = []
    for place in _PLACES:
        outer, inner = (ndtr((_DEPTHS - place - depth) / width) for depth in (0.0, _LAYER))
        layers = np.stack([1.0 - outer, outer - inner, inner], axis=1)
        signals = profiles @ np.linalg.pinv(layers).T
        misfit = ((profiles - signals @ layers.T) ** 2).sum(axis=1)
        # A dermis darker than any is air that is mistaken for it.
        dermis, fat = signals[:, 1] - air, signals[:, 2] - air
        out.append(misfit + 8.0 * np.maximum(_DARKEST * fat - dermis, 0.0) ** 2)
    return np.stack(out)


def _air(image: Image, values: Floats, head: Bools) -> tuple[float, float]:
    """Return mean and standard deviation of the noise around the head, robustly.

    Voxels of exactly 0 were masked by someone and tell nothing; where most are, there is no noise.
    """
    sample = values[(_depth(image, ~head) > _AIR[0])]
    told = sample[sample > 0.0]
    if len(told) < 0.1 * len(sample) or not len(told):
        return 0.0, 0.0
    middle = float(np.median(told))
    return middle, 1.4826 * float(np.median(np.abs(told - middle)))


def _cuts(image: Image, head: Bools) -> dict[str, float]:
    """Return by side of the field of view the area (mm²) of the head there."""
    out = {}
    for axis, names in enumerate(_ENDS):
        u, v = (image.axes[:, k] for k in range(3) if k != axis)
        area = float(np.linalg.norm(np.cross(u, v)))
        for name, end in zip(names, (0, -1), strict=True):
            found = area * float(np.take(head, end, axis).sum())
            if found > 0.0:
                out[name] = round(found, 1)
    return out
