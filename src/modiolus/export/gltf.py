"""glTF 2.0: the head with its expressions as morph targets, for animation programs.

glTF measures in metres with +y up and the face looking to +z, so a point (x, y, z) of the head
becomes (x, z, -y) / 1000.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pygltflib
from numpy.typing import NDArray

from modiolus import __version__
from modiolus.errors import InputError
from modiolus.export.shape import Shape, linear_light, vertex_normals
from modiolus.hermite.basis import Array
from modiolus.hermite.check import numbers

__all__ = ["in_turn", "write_glb"]


_TO_GLTF = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_MM_TO_M = 1e-3


def write_glb(
    path: Path,
    shapes: Sequence[Shape],
    targets: Mapping[str, Mapping[str, Array]],
    attribution: str = "",
    keys: tuple[Array, Array] | None = None,
    between: Mapping[str, tuple[str, float]] | None = None,
) -> None:
    """Write surfaces with their morph targets as one binary glTF file.

    Parameters
    ----------
    path : Path
        The file to write.
    shapes : sequence of Shape
        The neutral surfaces; each becomes a node with the shape's name.
    targets : mapping of str to mapping of str to (n, 3) array
        For the name of a shape: the vertices in mm at the full strength of each named target.
    attribution : str
        Who made the anatomy and under which licence.
    keys : (times (m,), weights (m, n)), optional
        Of an animation: at each time (s) the strength of every target, such as `in_turn` returns.
    between : mapping of str to (str, float), optional
        Targets that are in-betweens of others: of which, and at what strength. They are written
        as corrections, which added at full strength to the other's at its strength give the
        vertices.

    Raises
    ------
    InputError
        There is no shape or an empty one, a target does not fit its shape or is between what
        there is not, or shapes that are to be animated together have other targets.
    OSError
        The file cannot be written.
    """
    names = [shape.name for shape in shapes]
    if not shapes or not all(len(shape.faces) for shape in shapes):
        raise InputError("shapes: there is none, or an empty one; leave it out")
    for name in targets:
        if names.count(name) != 1:
            raise InputError(f"targets: {names.count(name)} shapes are called {name}; name one")
    writer = _Writer()
    for shape in shapes:
        writer.add(shape, targets.get(shape.name, {}), between or {})
    if keys is not None:
        writer.animate(*keys)
    writer.save(path, attribution)


def in_turn(count: int, seconds: float, between: int = 0) -> tuple[Array, Array]:
    """Return the keys of an animation in which targets come and go, one after the other.

    Parameters
    ----------
    count : int
        Number of targets, each followed by its in-betweens.
    seconds : float
        Time that each of them has.
    between : int
        Number of evenly spaced in-betweens of a target, each a correction as `write_glb` makes
        it: at full strength where the target has its share, and at none at the next one's.
    """
    # A target comes in so many steps, and goes in as many.
    steps = between + 1
    weights = np.zeros((2 * steps * count + 1, steps * count))
    for target in range(count):
        for step in range(1, 2 * steps):
            key = weights[2 * steps * target + step, steps * target : steps * (target + 1)]
            done = min(step, 2 * steps - step)
            key[0] = done / steps
            key[done % steps] = 1.0
    return np.linspace(0.0, count * seconds, len(weights)), weights


class _Writer:
    """Collects arrays in one buffer and the records that point into it."""

    def __init__(self) -> None:
        self.gltf = pygltflib.GLTF2()
        self.blob = bytearray()

    def accessor(
        self, array: NDArray[np.generic], kind: str, target: int | None, bounds: bool
    ) -> int:
        """Append an array and return the number of its accessor."""
        self.blob.extend(b"\0" * (-len(self.blob) % 4))
        gltf = self.gltf
        gltf.bufferViews.append(
            pygltflib.BufferView(
                buffer=0, byteOffset=len(self.blob), byteLength=array.nbytes, target=target
            )
        )
        self.blob.extend(array.tobytes())
        whole = array.dtype == np.uint32
        gltf.accessors.append(
            pygltflib.Accessor(
                bufferView=len(gltf.bufferViews) - 1,
                componentType=pygltflib.UNSIGNED_INT if whole else pygltflib.FLOAT,
                count=len(array),
                type=kind,
                min=np.atleast_1d(array.min(axis=0)).tolist() if bounds else None,
                max=np.atleast_1d(array.max(axis=0)).tolist() if bounds else None,
            )
        )
        return len(gltf.accessors) - 1

    def vectors(self, array: Array, bounds: bool = False) -> int:
        """Append vectors per vertex, (n, 3)."""
        single = np.ascontiguousarray(array, dtype=np.float32)
        return self.accessor(single, pygltflib.VEC3, pygltflib.ARRAY_BUFFER, bounds)

    def add(
        self,
        shape: Shape,
        targets: Mapping[str, Array],
        between: Mapping[str, tuple[str, float]],
    ) -> None:
        """Add a shape as a node of its own."""
        gltf = self.gltf
        normals = vertex_normals(shape.vertices, shape.faces) @ _TO_GLTF
        attributes = self._attributes(shape, normals)
        morphs = self._morphs(shape, normals, targets, between)
        triangles = np.ascontiguousarray(shape.faces, dtype=np.uint32).reshape(-1)
        # Colours of vertices are factors, too.
        single = np.asarray(shape.colour, dtype=float)
        colour = single if single.ndim == 1 else np.ones(3)
        gltf.materials.append(
            pygltflib.Material(
                name=shape.name,
                pbrMetallicRoughness=pygltflib.PbrMetallicRoughness(
                    baseColorFactor=[*linear_light(colour).tolist(), 1.0],
                    metallicFactor=0.0,
                    roughnessFactor=float(0.75 - 0.6 * shape.gloss),
                ),
                doubleSided=True,
            )
        )
        gltf.meshes.append(
            pygltflib.Mesh(
                name=shape.name,
                primitives=[
                    pygltflib.Primitive(
                        attributes=attributes,
                        indices=self.accessor(
                            triangles, pygltflib.SCALAR, pygltflib.ELEMENT_ARRAY_BUFFER, False
                        ),
                        material=len(gltf.materials) - 1,
                        targets=morphs,
                    )
                ],
                weights=[0.0] * len(targets),
                # Where the programs that read glTF look for the names of morph targets.
                extras={"targetNames": list(targets)} if targets else {},
            )
        )
        gltf.nodes.append(pygltflib.Node(name=shape.name, mesh=len(gltf.meshes) - 1))

    def _attributes(self, shape: Shape, normals: Array) -> pygltflib.Attributes:
        """Append what is known of every vertex at rest; ``normals`` (n, 3) are those of glTF."""
        attributes = pygltflib.Attributes(
            POSITION=self.vectors(shape.vertices @ _TO_GLTF * _MM_TO_M, bounds=True),
            NORMAL=self.vectors(normals),
        )
        if np.ndim(shape.colour) == 2:
            attributes.COLOR_0 = self.vectors(linear_light(np.asarray(shape.colour, dtype=float)))
        if shape.layout is not None:
            # glTF counts v from the upper edge of a texture.
            down = np.ascontiguousarray(shape.layout * [1, -1] + [0, 1], dtype=np.float32)
            attributes.TEXCOORD_0 = self.accessor(
                down, pygltflib.VEC2, pygltflib.ARRAY_BUFFER, False
            )
        return attributes

    def _morphs(
        self,
        shape: Shape,
        normals: Array,
        targets: Mapping[str, Array],
        between: Mapping[str, tuple[str, float]],
    ) -> list[dict[str, int]]:
        """Append how each target differs from rest, an in-between from its share of the whole."""
        changes: dict[str, tuple[Array, Array]] = {}
        for name, vertices in targets.items():
            numbers(name, vertices, *shape.vertices.shape)
            moved = (vertices - shape.vertices) @ _TO_GLTF * _MM_TO_M
            changes[name] = moved, vertex_normals(vertices, shape.faces) @ _TO_GLTF - normals
        morphs = []
        for name, (moved, turned) in changes.items():
            if name in between:
                whole, share = between[name]
                if whole not in changes:
                    raise InputError(f"{name}: in-between of {whole}, which is no target; add it")
                moved = moved - share * changes[whole][0]
                turned = turned - share * changes[whole][1]
            morphs.append(
                {"POSITION": self.vectors(moved, bounds=True), "NORMAL": self.vectors(turned)}
            )
        return morphs

    def animate(self, times: Array, weights: Array) -> None:
        """Let the targets have weights (m, n) at times (m,) in seconds."""
        gltf = self.gltf
        moving = [
            (node, mesh.extras["targetNames"])
            for node, mesh in enumerate(gltf.meshes)
            if "targetNames" in mesh.extras
        ]
        if not moving or any(names != moving[0][1] for _, names in moving):
            raise InputError("targets: animated shapes have other ones; give all of them the same")
        numbers("weights", weights, len(times), len(moving[0][1]))
        single = [np.asarray(part, dtype=np.float32).ravel() for part in (times, weights)]
        sampler = pygltflib.AnimationSampler(
            input=self.accessor(single[0], pygltflib.SCALAR, None, True),
            output=self.accessor(single[1], pygltflib.SCALAR, None, False),
            interpolation=pygltflib.ANIM_LINEAR,
        )
        channels = [
            pygltflib.AnimationChannel(
                sampler=0, target=pygltflib.AnimationChannelTarget(node=node, path="weights")
            )
            for node, _ in moving
        ]
        gltf.animations.append(
            pygltflib.Animation(name="expressions", channels=channels, samplers=[sampler])
        )

    def save(self, path: Path, attribution: str) -> None:
        """Write what has been added."""
        gltf = self.gltf
        gltf.asset = pygltflib.Asset(generator=f"modiolus {__version__}", version="2.0")
        if attribution:
            gltf.asset.copyright = attribution
        gltf.scenes.append(pygltflib.Scene(nodes=list(range(len(gltf.nodes)))))
        gltf.scene = 0
        gltf.buffers.append(pygltflib.Buffer(byteLength=len(self.blob)))
        gltf.set_binary_blob(bytes(self.blob))
        gltf.save_binary(str(path))
