"""The mechanical problem of a head: tissue, muscles, bone, lips and lids."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..anatomy.distance import DistanceGrid, MirroredDistance
from ..errors import InputError, unknown_name
from ..face.embed import CELL, cell_points
from ..face.expression import Expression, resolve
from ..face.head import Head
from ..face.jaw import FOLLOWERS, WIDEST, Jaw, opening
from ..face.refine import at_gauss
from ..hermite import Side, symmetry_plane, trapezoidal
from ..progress import Report
from .constraints import clamp
from .contact import RigidContact, SurfaceContact, face_points, known_offsets
from .continuation import Continuation
from .facing import Patches
from .laws import CARTILAGE, FAT, MUSCLE, Array, FibreLaw, mix
from .problem import GAUSS, Problem, State
from .terms import (
    FibreQuadrature,
    Fibres,
    GlidingFibres,
    GlidingQuadrature,
    IntArray,
    Load,
    PointTerm,
    Sheet,
    Springs,
)

Points = TypeVar("Points", bound=FibreQuadrature)


@dataclass(frozen=True)
class FaceSettings:
    """Parameters of the face's mechanics.

    Attributes
    ----------
    muscle : str
        Parameter set of passive muscle, see `modiolus.mechanics.laws.MUSCLE`.
    passive : float
        Factor of the stiffness of passive muscle.
    fat : float
        Factor of the stiffness of fat, see `modiolus.mechanics.laws.FAT`.
    sigma_max : float
        Greatest active fibre stress (kPa), Blemker et al. 2005.
    kappa : float
        Volumetric stiffness beside the pressure (kPa).
    modiolus : float
        c10 of the modiolus (kPa).
    skin : float
        c10 that the skin adds to the tissue under it (kPa), see `skin_share`.
    contact : float
        Penalty of all contacts (kPa/mm).
    slide : float
        Fraction of that penalty with which tissue that touches bone resists lift-off.
    reach : float
        Tissue within this distance (mm) of bone at rest slides on it.
    gauss_order : int
        Gauss points of the tissue in each direction of an element, 3 to 8.

    Raises
    ------
    InputError
        The parameter set is not known, a number is negative, beyond all tissue or no number, or 0
        where nothing would hold the tissue, pull it or keep it from overlapping.
    """

    muscle: str = "wu2013"
    passive: float = 1.0
    fat: float = 1.0
    sigma_max: float = 300.0
    kappa: float = 80.0
    modiolus: float = 30.0
    skin: float = 3.0
    contact: float = 250.0
    slide: float = 0.05
    reach: float = 2.0
    gauss_order: int = GAUSS

    def __post_init__(self) -> None:
        if self.muscle not in MUSCLE:
            raise unknown_name("passive muscle", self.muscle, MUSCLE)
        for name in (item.name for item in fields(self) if item.name != "muscle"):
            value = getattr(self, name)
            least = 0.0 if name in _MAY_BE_ZERO else np.finfo(float).tiny
            if not least <= value <= _MOST:
                bound = "from 0" if name in _MAY_BE_ZERO else "above 0"
                raise InputError(f"{name}: {value:g}; give a number {bound} up to {_MOST:g}")
        if self.gauss_order not in range(3, 9):
            raise InputError(f"gauss_order: {self.gauss_order:g} points; give 3 to 8")


#: Bone has some 1e7 kPa; nothing that is to deform here is within a tenth of it.
_MOST = 1e6
_MAY_BE_ZERO = ("kappa", "skin", "slide", "reach")
#: Thickness of the skin (mm): its dermis has 0.8 to 2.0 mm in the face.
DERMIS = 1.5
#: Deep structures that the tissue keeps to when it is pulled away: bone under thin tissue, and the
#: eyeball, to which the tears hold the lids.
SLIDING = ("skull", "mandible", "eyeball")
#: Teeth and gums touch the tissue as one arch each.
ARCHES: dict[str, tuple[str, ...]] = {
    "upper_arch": ("teeth_upper", "gums_upper"),
    "lower_arch": ("teeth_lower", "gums_lower"),
}
#: Rounding (mm) of edges and clefts of what tissue touches: soft tissue bridges the clefts, and on
#: sharp edges a mesh coarser than they are would catch. A muscle gives way, its edges all the more;
#: over the lower edge of the cheekbone the cheek slides by half a centimetre.
ROUNDING = 1.0
MORE_ROUNDING = {"masseter": 2.0, "skull": 1.5}
#: It does not within this distance (mm) of the gums, where the vestibule of the mouth parts
#: lips and cheeks from the bone.
VESTIBULE = 6.0
#: The nose's cartilage is no rigid body but part of the tissue, as far as it lies in it. Its walls
#: bend over the airway behind them. The septum stands on bone: inner surface within the first of
#: these distances (mm) of cartilage and within the second of the mid-plane is tied to its place
#: with the stiffness (kPa/mm) that gives the tip of the nose its measured resistance.
SEPTUM, SEPTUM_STIFFNESS = (1.0, 2.5), 3.0
#: Beyond the cuts through the neck the tissue goes on, and platysma in it, which pulls from there
#: as much as from here. So they stay at their height, and move in their plane against the shear of
#: what lies beyond (kPa/mm): sqrt(G k / h) for a layer of thickness h = 10 mm and a shear modulus
#: G = 2.8 kPa, held on its way by k = 0.15 kPa/mm (`embed.FASCIAE`). The cut through the scalp,
#: which slides over the skull, moves as bone leaves it; what mostly holds it is the galea.
CUT_STIFFNESS = 0.2
#: Cuts that move against it, and along how many of the axes.
FREE = {"neck": 2, "scalp": 3}
#: Contact points along the margin of a lip or lid, and across, on the side of every element. Where
#: one eye is shut tightly the edges of its lids cross askew: with fewer they cut in between.
MARGIN = 11, 7
#: Points along a lid, and up it, by which the inside of every element touches the eyeball. A lid is
#: one element high: between fewer points, and past the last of them, its edge sank in by 2 mm.
ON_EYE = 7, 11
#: How many times as stiff contact is there. A rising cheek is pressed on the edge of the cheekbone
#: at a few points, and comes off it that much sooner when contacts are pressed apart.
FIRM = {"skull": 3.0}


class Face:
    """A head that its muscles move.

    Parameters
    ----------
    head : Head or str
        The half, or the name or folder of one.
    settings : FaceSettings, optional

    Examples
    --------
    >>> state = Face("taro").express("smile-open")  # doctest: +SKIP
    """

    def __init__(self, head: Head | str = "taro", settings: FaceSettings | None = None) -> None:
        self.head = head if isinstance(head, Head) else Head.load(head)
        self.settings = FaceSettings() if settings is None else settings

    @cached_property
    def half(self) -> Problem:
        """The problem of one side, which is that of both when they do the same."""
        return face_problem(self.head, self.settings)

    @cached_property
    def whole(self) -> Problem:
        """The problem of both sides."""
        return face_problem(self.head.whole, self.settings)

    def problem(self, state: State) -> Problem:
        """Return the problem that a state solves, `half` or `whole`."""
        return self.half if self._is_half(state) else self.whole

    def express(
        self,
        expression: Expression | str,
        start: State | None = None,
        report: Report | None = None,
    ) -> State:
        """Follow the face to an expression, or to that of a name or a TOML file; see `solve`."""
        wanted = Expression.named(expression) if isinstance(expression, str) else expression
        return self.solve(wanted.activations, opening(wanted.jaw_open), start, report)

    def solve(
        self,
        activations: Mapping[str, float],
        jaw_open: float = 0.0,
        start: State | None = None,
        report: Report | None = None,
    ) -> State:
        """Follow the face to a load: one side of it when both do the same, or else both.

        Parameters
        ----------
        activations : mapping of str to float
            0..1 by muscle or group of muscles, with ``_left`` or ``_right`` for one side.
        jaw_open : float
            Angle in radians, 0 to that of 30°; see `modiolus.face.jaw.opening`.
        start : State, optional
            Where to begin; rest by default. From a state of both sides the way stays on both.
        report : callable, optional
            Told the share that is done and what goes on.

        Raises
        ------
        InputError
            If a muscle is not known, an activation is not within 0..1, the angle is none to which a
            jaw opens, or the head has no jaw.
        LoadNotReached
            The computation stopped on the way; it has the last state.
        """
        # Degrees would turn the jaw round several times.
        if not -1e-9 <= jaw_open <= opening(WIDEST) + 1e-9:
            raise InputError(
                f"jaw_open: {jaw_open:g} is not within 0 to {opening(WIDEST):.3f} radians; give an "
                "angle in there, such as modiolus.face.jaw.opening(12.0)"
            )
        wanted = resolve(activations, self.head.muscles)
        if set(wanted) <= set(self.head.muscles) and (start is None or self._is_half(start)):
            problem, head = self.half, self.head
        else:
            problem, head, wanted = self.whole, self.head.whole, self._sided(wanted)
            if start is not None and self._is_half(start):
                known = start.parameters, start.pressure, start.activations, start.load.jaw
                start = self.state(*known, both=True, offsets=start.load.offsets)
        load = face_load(problem, head, wanted, jaw_open)
        return Continuation(problem, start, report=report).run(load)

    def state(
        self,
        parameters: Array,
        pressure: Array,
        activations: Mapping[str, float],
        jaw: float = 0.0,
        both: bool = False,
        offsets: Mapping[str, Array] | None = None,
    ) -> State:
        """Return a state that was computed earlier.

        Parameters
        ----------
        parameters : (n_params, 3) array
            Of the tissue of the half, or of both sides (mm).
        pressure : (n_vertices,) array
            In kPa.
        activations : mapping of str to float
            By muscle.
        jaw : float
            Angle in radians by which the jaw is open.
        both : bool
            Whether to return both sides also of a state of one.
        offsets : mapping of str to (n,) array, optional
            By which its contacts are pressed apart (`Load.offsets`, mm); not at all by default.

        Raises
        ------
        InputError
            The arrays do not fit the head, or the offsets its contacts.
        """
        on_half = len(parameters) == self.head.tissue.n_params
        if on_half and not both:
            problem, head = self.half, self.head
        else:
            problem, head = self.whole, self.head.whole
        rest = problem.rest()
        if both and on_half:
            parameters = self.head.both.whole(parameters)
            corners = self.head.tissue.corner_nodes()[0]
            # The image of a corner lies at the other end of xi1.
            corners = np.vstack([corners, corners[:, np.arange(8) ^ 1]])
            if len(pressure) == corners.max() + 1:
                doubled = np.empty(len(rest.pressure))
                doubled[rest.vertices] = pressure[corners]
                pressure = doubled
        if parameters.shape != rest.parameters.shape or pressure.shape != rest.pressure.shape:
            raise InputError("state: its arrays do not fit the head; simulate it anew")
        if head is not self.head:
            activations = self._sided(activations)
        load = face_load(problem, head, activations, jaw)
        known = known_offsets(problem.terms, problem.mesh, offsets or {}, self.head.midplane)
        load = replace(load, offsets=known)
        return replace(rest, parameters=parameters, pressure=pressure, load=load)

    def _is_half(self, state: State) -> bool:
        return len(state.parameters) == self.head.tissue.n_params

    def _sided(self, activations: Mapping[str, float]) -> dict[str, float]:
        """Return activations by muscle and side."""
        return {
            muscle: value
            for name, value in activations.items()
            for muscle in (
                (f"{name}_left", f"{name}_right") if name in self.head.muscles else (name,)
            )
        }


def face_problem(
    head: Head,
    settings: FaceSettings | None = None,
    terms: Sequence[PointTerm] = (),
    measured: Head | None = None,
) -> Problem:
    """Set up the equilibrium of a head's half face, or of both sides of `Head.whole`.

    Parameters
    ----------
    head : Head
    settings : FaceSettings, optional
    terms : sequence of PointTerm, optional
        What acts on the face besides, such as its weight.
    measured : Head, optional
        The head in the shape that was measured, where that is not its shape at rest: in it the
        tissue touches deep structures without force, and the muscles are located.

    Returns
    -------
    Problem
        Driven by the activations of the head's muscles; `face_load` opens the jaw as well.
    """
    settings = FaceSettings() if settings is None else settings
    mesh = head.tissue
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    if head.half is None:
        fixed |= symmetry_plane(mesh, *head.sides["midplane"])
    for name, cut in cuts(head):
        held = clamp(mesh, *cut)
        held[:, : FREE.get(_part(name), 0)] = False
        fixed |= held
    acting = list(terms)
    # Bodies are rounded while the muscles are placed.
    with ThreadPoolExecutor(1) as beside:
        bodies = beside.submit(_bodies, head)
        acting += [*fibres(head, settings, measured), *_springs(head, measured)]
    acting += [
        Sheet(mesh, item.elements, item.xi, item.stiffness, name)
        for name, item in head.sheets.items()
    ]
    acting += _deep_contacts(head, settings, measured, bodies.result())
    acting += _slit_contacts(head, settings)
    return Problem(
        mesh,
        tissue(head, settings, measured),
        kappa=settings.kappa,
        gauss_order=settings.gauss_order,
        terms=acting,
        fixed=fixed,
        places=head.landmark_points(),
    )


def other_tissue(problem: Problem, head: Head, settings: FaceSettings) -> Problem:
    """Return a head's problem with the tissue and the greatest stress of other settings.

    It shares with the given one all that depends on the shape, see `Problem.varied`.
    """
    return problem.varied(tissue(head, settings), FibreLaw(sigma_max=settings.sigma_max))


def tissue(head: Head, settings: FaceSettings, measured: Head | None = None) -> Array:
    """Return the coefficients of fat, muscle, skin, modiolus and cartilage at the Gauss points.

    Parameters
    ----------
    head : Head
    settings : FaceSettings
    measured : Head, optional
        As of `face_problem`: in its shape lies the cartilage where it is known to.

    Returns
    -------
    (n_elements, q, 3) array
        ``(c10, c01, c20)`` in kPa: a constant, and what is linear in `passive`, `fat`, `skin` and
        `modiolus`.
    """
    order = settings.gauss_order
    fraction, firmness = (at_gauss(values, order) for values in (head.fraction, head.firmness))
    muscle, fat = MUSCLE[settings.muscle].times(settings.passive), FAT.times(settings.fat)
    coefficients = mix(fraction, muscle, fat)
    coefficients[..., 0] += settings.skin * skin_share(head, order)
    knot = firmness[..., None]
    coefficients = (1.0 - knot) * coefficients + knot * np.array([settings.modiolus, 0.0, 0.0])
    stiff = cartilage_share(measured or head, order)[..., None]
    return np.asarray((1.0 - stiff) * coefficients + stiff * CARTILAGE.array())


def skin_share(head: Head, gauss_order: int = GAUSS) -> Array:
    """Return the share of skin at the Gauss points, (n_elements, q).

    It fades around the depth of `DERMIS` below the outer surface.
    """
    mesh = head.tissue
    elements, xi = Problem.gauss_points(mesh, gauss_order)
    above = xi.copy()
    above[:, 2] = 1.0
    skin = mesh.evaluate(head.skinward[elements], above)
    depth = np.linalg.norm(skin - mesh.evaluate(elements, xi), axis=1)
    return np.asarray(np.clip(1.5 - depth / DERMIS, 0.0, 1.0).reshape(mesh.n_elements, -1))


def cartilage_share(head: Head, gauss_order: int = GAUSS) -> Array:
    """Return the volume share of cartilage around the Gauss points, (n_elements, q)."""
    mesh = head.tissue
    elements, xi = Problem.gauss_points(mesh, gauss_order)
    share = np.zeros(len(elements))
    if "cartilage" in head.deep:
        surface = head.distance("cartilage")
        near = surface.sample(mesh.evaluate(elements, xi)).distance < CELL
        host, around = cell_points(elements[near], xi[near])
        inside = surface.sample(mesh.evaluate(host, around)).distance < 0.0
        share[near] = inside.reshape(int(near.sum()), -1).mean(axis=1)
    return share.reshape(mesh.n_elements, -1)


def cuts(head: Head) -> Iterator[tuple[str, Side]]:
    """Yield the sides along which the tissue has been cut out of the head."""
    for name, side in head.sides.items():
        if _part(name) in ("ear", "neck", "scalp"):
            yield name, side


def _part(cut: str) -> str:
    """Return what a cut of `cuts` goes through."""
    return cut.partition("_")[0]


def face_load(
    problem: Problem, head: Head, activations: Mapping[str, float], jaw_open: float = 0.0
) -> Load:
    """Return the load of activations and an open jaw.

    What holds the tissue follows the jaw where it is tied to it: the cuts at the ear and the neck
    move by the share of `Jaw.share`.

    Parameters
    ----------
    problem : Problem
        Of `face_problem`.
    head : Head
        The same.
    activations : mapping of str to float
        0..1 by muscle.
    jaw_open : float
        Angle in radians, see `modiolus.face.jaw.opening`.

    Raises
    ------
    InputError
        If a muscle is not known, an activation is not within 0..1, or the head has no jaw.
    """
    load = problem.load(activations)
    if jaw_open == 0.0:
        return load
    if head.jaw is None:
        raise InputError(f"{head.name}: the head has no mandible; leave its jaw closed")
    mesh = problem.mesh
    faces = [face_points(mesh, *cut)[:2] for _, cut in cuts(head)]
    elements, xi = (np.concatenate(part) for part in zip(*faces, strict=True))
    points = mesh.evaluate(elements, xi)
    moved = head.jaw.displacement(points, jaw_open, head.jaw.share(points))
    held = np.unique(np.concatenate([mesh.face_parameters(*cut)[0] for _, cut in cuts(head)]))
    if head.half is None:
        # The jaw moves in planes of constant x, so that slopes across the mid-plane stay zero.
        held = np.setdiff1d(held, mesh.face_parameters(*head.sides["midplane"])[1])
    functions = mesh.functions(elements, xi)[:, held].toarray()
    prescribed = np.zeros(mesh.parameters.shape)
    prescribed[held] = np.linalg.lstsq(functions, moved, rcond=None)[0]
    return replace(load, prescribed=prescribed, jaw=jaw_open)


def fibres(head: Head, settings: FaceSettings, measured: Head | None = None) -> Iterator[Fibres]:
    """Embed the muscles: their own quadrature points, located once in the tissue.

    They are those of the measured head where there is one, carried to the shape at rest.
    """
    source = measured or head
    half = source.half or source
    moving: list[FibreQuadrature] = []
    gliding: list[GlidingQuadrature] = []
    rules = [muscle.fibre_points(source.fineness) for muscle in half.muscles.values()]
    place = half.tissue.locate(np.concatenate([rule.points for rule in rules]))
    ends = np.cumsum([len(rule.points) for rule in rules])
    numbered = 0
    for number, (muscle, rule, end) in enumerate(
        zip(half.muscles.values(), rules, ends, strict=True)
    ):
        these = slice(end - len(rule.points), end)
        held = place.distance[these] < 0.05
        index = np.full(len(held), number)
        at = place.elements[these], place.xi[these]
        points = *at, rule.weights, rule.directions, index
        if muscle.glide == 0.0:
            moving.append(FibreQuadrature(*points).take(held))
            continue
        lines, pulls = muscle.pulls(rule, held)
        bound = np.bincount(lines, np.abs(pulls))[lines] > 0.0
        gliding.append(GlidingQuadrature(*points, numbered + lines, pulls).take(bound))
        numbered += int(lines.max()) + 1
    law = FibreLaw(sigma_max=settings.sigma_max)
    slacks = {name: muscle.slack for name, muscle in head.muscles.items()}

    def placed(parts: Sequence[Points]) -> Points:
        whole = type(parts[0]).concatenate(parts)
        if source.half is not None:
            whole = both_sides(whole, source.half)
        return whole if measured is None else whole.carried(measured.tissue, head.tissue)

    if moving:
        yield Fibres(head.tissue, placed(moving), list(head.muscles), law, slacks)
    if gliding:
        yield GlidingFibres(
            head.tissue, placed(gliding), list(head.muscles), law, slacks, _bones(head)
        )


def _bones(head: Head) -> Callable[[Array, IntArray], Callable[[Load], Array]] | None:
    """Return how the bones move from which muscles glide: with the jaw, by the origin's share."""
    jaw = head.jaw
    if jaw is None:
        return None

    @cache
    def shares() -> Array:
        ends = [m.end(0)[0].mean(axis=0) if m.glide else jaw.hinge for m in head.muscles.values()]
        return jaw.share(np.stack(ends))

    return lambda rest, muscles: _carried(jaw, rest, lambda: shares()[muscles])


def _carried(jaw: Jaw, rest: Array, share: Callable[[], Array]) -> Callable[[Load], Array]:
    """Return what takes a load to where points go with the jaw; a closed one needs no share."""
    known = cache(share)

    def place(load: Load) -> Array:
        if load.jaw == 0.0:
            return rest
        return np.asarray(rest + jaw.displacement(rest, load.jaw, known()))

    return place


def both_sides(quadrature: Points, half: Head) -> Points:
    """Return the points of a half's muscles and their images, in the order of the whole's."""
    elements, xi = half.both.points(quadrature.elements, quadrature.xi)
    left = replace(quadrature, muscles=2 * quadrature.muscles)
    right = replace(
        quadrature,
        elements=elements,
        xi=xi,
        directions=quadrature.directions * [-1.0, 1.0, 1.0],
        muscles=2 * quadrature.muscles + 1,
    )
    if isinstance(right, GlidingQuadrature):
        right = replace(right, fibres=right.fibres + right.fibres.max(initial=-1) + 1)
    return type(quadrature).concatenate([left, right])


def _springs(head: Head, measured: Head | None) -> Iterator[Springs]:
    jaw = head.jaw
    carry = None if jaw is None else lambda rest: _carried(jaw, rest, lambda: jaw.share(rest))
    tied, bound = (
        [(item.elements, item.xi, item.stiffness) for item in items.values()]
        for items in (head.attachments, head.insertions)
    )
    for name, cut in cuts(head):
        if _part(name) in FREE:
            elements, xi, areas = face_points(head.tissue, *cut)
            tied.append((elements, xi, CUT_STIFFNESS * areas))
    if tied:
        elements, xi, stiffness = map(np.concatenate, zip(*tied, strict=True))
        yield Springs(head.tissue, elements, xi, stiffness, "attachments", carry)
    if bound:
        elements, xi, stiffness = map(np.concatenate, zip(*bound, strict=True))
        skin = head.skinward[elements], xi * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
        yield Springs(head.tissue, elements, xi, stiffness, "insertions", to=skin)
    if "cartilage" in head.deep:
        elements, xi, areas = face_points(head.tissue, *head.sides["inner"])
        points = (measured or head).tissue.evaluate(elements, xi)
        held = np.abs(points[:, 0] - head.midplane) < SEPTUM[1]
        held &= head.distance("cartilage").sample(points).distance < SEPTUM[0]
        stiffness = SEPTUM_STIFFNESS * areas[held]
        yield Springs(head.tissue, elements[held], xi[held], stiffness, "attachments")


def _deep_contacts(
    head: Head, settings: FaceSettings, measured: Head | None, bodies: Mapping[str, DistanceGrid]
) -> Iterator[RigidContact]:
    """Put the inner surface against every deep structure that it may reach."""
    shape = (measured or head).tissue
    for name, grid in bodies.items():
        elements, xi, areas = _inside(head, ON_EYE if name == "eyeball" else None)
        points = shape.evaluate(elements, xi)
        surface = MirroredDistance(grid, head.midplane)
        distance = surface.sample(points).distance
        near = distance < grid.band - 0.2
        if not near.any():
            continue
        free = _vestibule(head, points[near])
        slides = (distance[near] < settings.reach) & ~free & (name in SLIDING)
        firm = FIRM.get(name, 1.0)
        yield RigidContact(
            head.tissue,
            surface,
            elements[near],
            xi[near],
            areas[near],
            firm * settings.contact,
            slide=settings.slide / firm * slides,
            name=f"contact with {name}",
            motion=_motion(head.jaw, FOLLOWERS.get(name, 0.0)),
            touching=None if measured is None else measured.tissue,
        )


def _inside(head: Head, counts: tuple[int, int] | None) -> tuple[IntArray, Array, Array]:
    """Return points of the inner surface: Gauss points, or so many up to all of its borders."""
    elements, axis, side = head.sides["inner"]
    if counts is None:
        return face_points(head.tissue, elements, axis, side)
    patches, xi, areas = Patches.of(head.tissue, head.sides["inner"]).points(*trapezoidal(counts))
    return np.asarray(elements)[patches], np.insert(xi, axis, float(side), axis=1), areas


def _bodies(head: Head) -> dict[str, DistanceGrid]:
    """Return what the tissue touches: rigid structures, with teeth and gums as one arch each."""
    parts = {name: [item.distance] for name, item in head.deep.items() if name != "cartilage"}
    for arch, names in ARCHES.items():
        found = [grid for name in names for grid in parts.pop(name, [])]
        if found:
            parts[arch] = found
    # A ball has no clefts.
    return {
        name: grids[0]
        if name == "eyeball"
        else DistanceGrid.rounded(grids, MORE_ROUNDING.get(name, ROUNDING))
        for name, grids in parts.items()
    }


def _vestibule(head: Head, points: Array) -> NDArray[np.bool_]:
    """Tell which points face the vestibule of the mouth, where tissue lifts off freely."""
    out = np.zeros(len(points), dtype=bool)
    for name in ("gums_upper", "gums_lower"):
        if name in head.deep:
            out |= head.distance(name).sample(points).distance < VESTIBULE
    return out


def _motion(jaw: Jaw | None, share: float) -> Callable[[Load], tuple[Array, Array]] | None:
    """Return how a deep structure that follows the jaw by a share of its angle moves."""
    if jaw is None or share == 0.0:
        return None
    return lambda load: jaw.pose(share * load.jaw)


def _slit_contacts(head: Head, settings: FaceSettings) -> Iterator[PointTerm]:
    """Put the upper against the lower lip and lid, and the lower against the upper."""
    for part in ("lip", "lid"):
        margins = {which: head.sides[f"{part}_{which}"] for which in ("upper", "lower")}
        flanks = {which: _flanks(head, side[0]) for which, side in margins.items()}
        for which, other in (("upper", "lower"), ("lower", "upper")):
            contact = SurfaceContact(
                head.tissue,
                margins[which],
                margins[other],
                0.5 * settings.contact,
                points=Patches.of(head.tissue, margins[which]).points(*trapezoidal(MARGIN)),
                flanks=(flanks[which], flanks[other]),
                name=f"contact of the {which} {part}",
            )
            yield from filter(None, (contact, contact.edges))


def _flanks(head: Head, elements: NDArray[np.int64]) -> list[Side]:
    """Return the skin of some elements and their side towards the mouth or the eye."""
    return [
        (np.intersect1d(elements, every), axis, side)
        for every, axis, side in (head.sides["outer"], head.sides["inner"])
    ]
