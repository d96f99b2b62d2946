"""The malar part of orbicularis oculi, which the source lacks, laid in the tissue.

The source's orbicularis oculi ends below the orbit's rim. In life it goes on: it "spreads over the
temple and downward on the cheek" (Gray's Anatomy), and bands go down beside its lateral edge, to
the zygomatic arch, the cheek or the mouth (malaris muscle; Park et al. 2011, J. Craniofac. Surg.
22:659-662; Kampan et al. 2018, Anat. Sci. Int. 93:364-371). They lift the skin of the cheek
(Zufferey 2013, Eur. J. Plast. Surg. 36:345-352). The lateral orbital thickening ties the muscle to
the orbit's rim (Muzaffar, Mendelson and Adams 2002, Plast. Reconstr. Surg. 110:873-884).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..hermite import HermiteMesh, grid
from ..hermite.basis import Array
from .embed import SLACK
from .muscle import Muscle
from .template import COLUMNS

__all__ = ["MALAR", "below", "malar_part"]

MALAR = "orbicularis_oculi_malar"

#: Its ends, from medial to lateral, in columns and rows of the template: from the orbit's rim
#: beside the lateral canthus to the skin over the cheekbone.
_ORIGIN = ((7.3, 13.9), (8.7, 14.4))
_INSERTION = ((6.2, 10.2), (8.0, 10.2))
#: Depth below the skin and thickness (mm): between the skin and the superficial fascia.
_DEPTH, _THICKNESS = 2.5, 1.0
#: Elements along and across.
_COUNTS = (4, 2)
#: Share of the length from which on fewer and fewer fibres go on: they end in the skin all along.
#: Its bands are loose, and with an edge as thick as its middle it would fold the cheek there.
_FADING = 0.5


def malar_part(tissue: HermiteMesh) -> Muscle:
    """Lay the muscle into the tissue of a half that is divided as the template is."""
    along, across = (np.linspace(0.0, 1.0, n + 1) for n in _COUNTS)
    ends = np.array([_ORIGIN, _INSERTION])
    sides = (1.0 - along)[:, None, None] * ends[0] + along[:, None, None] * ends[1]
    places = (1.0 - across)[:, None] * sides[:, None, 0] + across[:, None] * sides[:, None, 1]
    layers = [_DEPTH + 0.5 * _THICKNESS, _DEPTH - 0.5 * _THICKNESS]
    nodes = np.stack([below(tissue, places, depth) for depth in layers], axis=2)
    return Muscle(MALAR, grid(nodes), "strap", slack=SLACK, fading=_FADING)


def below(tissue: HermiteMesh, places: ArrayLike, depth: float) -> Array:
    """Return points (..., 3) at a depth below columns and rows (..., 2) of the template."""
    places = np.asarray(places, dtype=float)
    cells = places.astype(np.int64).reshape(-1, 2)
    elements = cells[:, 0] + COLUMNS * cells[:, 1]
    xi = np.column_stack([places.reshape(-1, 2) - cells, np.ones(len(cells))])
    skin = tissue.evaluate(elements, xi)
    inner = tissue.evaluate(elements, xi * [1.0, 1.0, 0.0])
    xi[:, 2] -= depth / np.linalg.norm(skin - inner, axis=1)
    return tissue.evaluate(elements, xi).reshape(*places.shape[:-1], 3)
