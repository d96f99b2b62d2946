"""Heads for tests: one that ships, and a small one, two blocks that meet like lips on bone."""

import signal

import numpy as np
import pytest
import scipy.sparse as sp

from modiolus import hermite
from modiolus.anatomy import DistanceGrid
from modiolus.face.head import Attachment, Head, RigidSurface
from modiolus.face.muscle import Muscle
from modiolus.hermite import HermiteMesh, gauss
from modiolus.scans.skin import Skin

# What a shell starts in the background ignores Ctrl-C, and so would all tests of it.
signal.signal(signal.SIGINT, signal.default_int_handler)


def _block(x, y, z, counts):
    """Nodes along x, z and against y, so that xi3 points out of the face."""
    ticks = [np.linspace(*ends, n + 1) for ends, n in zip((x, z, y[::-1]), counts, strict=True)]
    grid = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)
    return grid[..., [0, 2, 1]]


def _box(low, high, spacing=2.0):
    """Distance to a box on a grid around it."""
    low, high = np.array(low), np.array(high)
    origin = low - 8.0
    shape = np.ceil((high - low + 16.0) / spacing).astype(int) + 1
    axes = [origin[k] + spacing * np.arange(shape[k]) for k in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    beyond = np.abs(points - 0.5 * (low + high)) - 0.5 * (high - low)
    distance = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    distance += np.minimum(beyond.max(axis=-1), 0.0)
    return DistanceGrid(origin, spacing, np.round(np.clip(distance / 0.05, -127, 127)).astype("i1"))


@pytest.fixture(scope="session")
def taro():
    return Head.load("taro")


@pytest.fixture(scope="session")
def skin(taro):
    return Skin(taro)


@pytest.fixture(scope="session")
def block_head():
    plane = -0.5
    lower = hermite.grid(_block((plane, 24.0), (0.0, 10.5), (-16.0, 0.0), (2, 2, 1)))
    upper = hermite.grid(_block((plane, 24.0), (0.0, 10.5), (0.0, 16.0), (2, 2, 1)))
    tissue = HermiteMesh(
        3,
        np.vstack([lower.parameters, upper.parameters]),
        sp.csr_matrix(sp.block_diag([lower.extraction, upper.extraction])),
    )
    every = np.arange(8)
    sides = {
        "outer": (every, 2, 1),
        "inner": (every, 2, 0),
        "midplane": (every[every % 2 == 0], 0, 0),
        "ear": (every[every % 2 == 1], 0, 1),
        "neck": (every[:2], 1, 0),
        "scalp": (every[6:], 1, 1),
    }
    for part in ("lip", "lid"):
        sides[f"{part}_lower"] = (np.array([2, 3]), 1, 1)
        sides[f"{part}_upper"] = (np.array([4, 5]), 1, 0)
    belly = _block((4.0, 14.0), (4.0, 7.0), (-9.0, -6.0), (3, 1, 1))
    # Its fibres rise along x, so that it pulls the tissue about it both ways.
    belly[..., 2] += 0.2 * belly[..., 0]
    muscle = Muscle("strap", hermite.grid(belly), "strap", slack=1.1)
    elements = np.repeat([0, 2], 16)
    xi = np.insert(np.tile(gauss(2, 4)[0], (2, 1)), 2, 0.0, axis=1)
    rng = np.random.default_rng(3)
    return Head(
        name="block",
        tissue=tissue,
        sides=sides,
        landmarks={
            "chin": (0, (0.0, 0.5, 1.0)),
            "brow": (6, (0.0, 0.5, 1.0)),
            "corner": (3, (0.5, 1.0, 1.0)),
        },
        fraction=rng.uniform(0.0, 1.0, (8, 64)),
        firmness=rng.uniform(0.0, 0.2, (8, 64)),
        muscles={"strap": muscle},
        deep={
            "skull": RigidSurface("skull", _box((-30.0, 11.0, 3.0), (30.0, 50.0, 40.0))),
            "mandible": RigidSurface("mandible", _box((-30.0, 11.0, -40.0), (30.0, 50.0, -3.0))),
        },
        attachments={"ligament": Attachment("ligament", elements, xi, np.full(32, 300.0))},
        insertions={
            "strap": Attachment(
                "strap", elements, xi + np.array([0.0, 0.0, 0.5]), np.full(32, 20.0)
            )
        },
        sheets={
            "smas": Attachment(
                "smas", elements, xi + np.array([0.0, 0.0, 0.7]), rng.uniform(5.0, 10.0, 32)
            )
        },
        midplane=plane,
    )
