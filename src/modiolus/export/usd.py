"""USD: the head with its expressions as blend shapes of UsdSkel, which know in-betweens.

Points are in the frame of the head, in mm with +z up, and the stage says so.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from modiolus import __version__
from modiolus.errors import InputError
from modiolus.export.shape import Shape, linear_light, vertex_normals
from modiolus.hermite.basis import Array
from modiolus.hermite.check import numbers

__all__ = ["write_usd"]

_RATE = 24.0


def _pxr() -> Any:
    """Return the library, or say how to get it."""
    try:
        import pxr.Gf
        import pxr.Sdf
        import pxr.Tf
        import pxr.Usd
        import pxr.UsdGeom
        import pxr.UsdSkel
        import pxr.Vt
    except ImportError:
        raise InputError(
            "--usd: usd-core is not installed; install modiolus with its extra usd"
        ) from None
    return pxr


def write_usd(
    path: Path,
    shapes: Sequence[Shape],
    targets: Mapping[str, Mapping[str, Array]],
    attribution: str = "",
    keys: tuple[Array, Array] | None = None,
    between: Mapping[str, tuple[str, float]] | None = None,
) -> None:
    """Write surfaces with their blend shapes as a USD stage.

    Parameters
    ----------
    path : Path
        The file to write, .usdc or .usda.
    shapes : sequence of Shape
        The neutral surfaces; each becomes a mesh under ``/Face``.
    targets : mapping of str to mapping of str to (n, 3) array
        For the name of a shape: the vertices in mm at the full strength of each named target.
    attribution : str
        Who made the anatomy and under which licence.
    keys : (times (m,), weights (m, n)), optional
        Of an animation: at each time (s) the strength of every target that is no in-between.
    between : mapping of str to (str, float), optional
        Targets that are in-betweens of others: of which, and at what strength.

    Raises
    ------
    InputError
        The library is not installed, there is no shape, or a target does not fit its shape or is
        between what there is not.
    OSError
        The file cannot be written.
    """
    pxr, between = _pxr(), between or {}
    if not shapes or not all(len(shape.faces) for shape in shapes):
        raise InputError("shapes: there is none, or an empty one; leave it out")
    stage = pxr.Usd.Stage.CreateInMemory()
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.z)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 0.001)
    stage.SetTimeCodesPerSecond(_RATE)
    root = pxr.UsdSkel.Root.Define(stage, "/Face")
    stage.SetDefaultPrim(root.GetPrim())
    layer = stage.GetRootLayer()
    layer.comment = f"modiolus {__version__}"
    layer.customLayerData = {"copyright": attribution}
    skeleton = _skeleton(pxr, stage)
    names = dict.fromkeys(n for shape in targets.values() for n in shape if n not in between)
    animation = pxr.UsdSkel.Animation.Define(stage, "/Face/Animation")
    animation.CreateBlendShapesAttr(list(names))
    weights = animation.CreateBlendShapeWeightsAttr([0.0] * len(names))
    if keys is not None:
        times, strengths = keys
        numbers("weights", strengths, len(times), len(names))
        stage.SetStartTimeCode(0.0)
        stage.SetEndTimeCode(_RATE * float(times[-1]))
        for time, row in zip(times.tolist(), strengths.tolist(), strict=True):
            weights.Set(row, _RATE * time)
    binding = pxr.UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    for shape in shapes:
        _add(pxr, stage, shape, targets.get(shape.name, {}), between)
    try:
        written = layer.Export(str(path))
    except pxr.Tf.ErrorException:
        written = False
    if not written:
        raise OSError(errno.EIO, "USD could not write the file", str(path))


def _skeleton(pxr: Any, stage: Any) -> Any:
    """Define the one joint without which programs ignore blend shapes; it moves nothing."""
    skeleton = pxr.UsdSkel.Skeleton.Define(stage, "/Face/Skeleton")
    skeleton.CreateJointsAttr(["head"])
    for create in (skeleton.CreateBindTransformsAttr, skeleton.CreateRestTransformsAttr):
        create([pxr.Gf.Matrix4d(1.0)])
    return skeleton


def _add(
    pxr: Any,
    stage: Any,
    shape: Shape,
    targets: Mapping[str, Array],
    between: Mapping[str, tuple[str, float]],
) -> None:
    """Add a shape as a mesh, with its blend shapes below it."""

    def vectors(values: Array) -> Any:
        return pxr.Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))

    mesh = pxr.UsdGeom.Mesh.Define(stage, f"/Face/{pxr.Tf.MakeValidIdentifier(shape.name)}")
    normals = vertex_normals(shape.vertices, shape.faces)
    mesh.CreatePointsAttr(vectors(shape.vertices))
    mesh.CreateFaceVertexCountsAttr([3] * len(shape.faces))
    mesh.CreateFaceVertexIndicesAttr(shape.faces.ravel().tolist())
    mesh.CreateNormalsAttr(vectors(normals))
    mesh.SetNormalsInterpolation(pxr.UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    extent = np.stack([shape.vertices.min(axis=0), shape.vertices.max(axis=0)])
    mesh.CreateExtentAttr(vectors(extent))
    colour = linear_light(np.atleast_2d(np.asarray(shape.colour, dtype=float)))
    kinds = pxr.UsdGeom.Tokens
    mesh.CreateDisplayColorPrimvar(kinds.constant if len(colour) == 1 else kinds.vertex).Set(
        vectors(colour)
    )
    if shape.layout is not None:
        pair = np.ascontiguousarray(shape.layout, dtype=np.float32)
        pxr.UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "st", pxr.Sdf.ValueTypeNames.TexCoord2fArray, kinds.vertex
        ).Set(pxr.Vt.Vec2fArray.FromNumpy(pair))
    binding = pxr.UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/Face/Skeleton"])
    blends: dict[str, Any] = {}
    for name, vertices in sorted(targets.items(), key=lambda item: item[0] in between):
        numbers(name, vertices, *shape.vertices.shape)
        moved = vectors(vertices - shape.vertices)
        turned = vectors(vertex_normals(vertices, shape.faces) - normals)
        identifier = pxr.Tf.MakeValidIdentifier(name)
        if name in between:
            whole, share = between[name]
            if whole not in blends:
                raise InputError(f"{name}: in-between of {whole}, which is no target; add it")
            part = blends[whole].CreateInbetween(identifier)
            part.SetWeight(share)
            part.SetOffsets(moved)
            part.CreateNormalOffsetsAttr(turned)
            continue
        blend = pxr.UsdSkel.BlendShape.Define(stage, mesh.GetPath().AppendChild(identifier))
        blend.CreateOffsetsAttr(moved)
        blend.CreateNormalOffsetsAttr(turned)
        blends[name] = blend
    if blends:
        binding.CreateBlendShapesAttr(list(blends))
        binding.CreateBlendShapeTargetsRel().SetTargets([b.GetPath() for b in blends.values()])
