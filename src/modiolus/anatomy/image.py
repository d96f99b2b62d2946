"""Images in three dimensions, read and written in one frame: LPS, in millimetres.

Whatever way a scanner or a program stored an image, `read_image` gives an array whose axes run
towards the subject's left, backwards and up, as closely as the stored axes allow; an oblique image
stays oblique and `Image.axes` says how. Files are read by SimpleITK [1]_, after their headers have
been checked, so that a damaged or hostile file costs neither time nor memory.

References
----------
.. [1] B. C. Lowekamp et al., "The design of SimpleITK", Front. Neuroinform. 7 (2013) 45.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modiolus.errors import InputError

__all__ = ["Image", "read_image", "write_image"]

Array = NDArray[np.float64]

_FILES = (".nii", ".nii.gz", ".nrrd", ".mha")
#: Voxels of the largest image that is read, and along one axis.
_MOST_VOXELS, _LONGEST = 512**3, 2048
#: Fewer voxels along an axis than this show no face.
_SHORTEST = 8
#: Least and largest distance (mm) of voxels that is believed.
_SPACINGS = (0.05, 10.0)
#: Files of a DICOM series beyond which it is none of a head.
_MOST_FILES = 4096
#: Numbers of a NIfTI file that may not be finite, by its code and their bits.
_NIFTI_FLOATS = {(16, 32): "f4", (64, 64): "f8"}
#: Bytes that are unpacked at once when a file is checked.
_CHUNK = 2**20


@dataclass(frozen=True, eq=False)
class Image:
    """A scalar image on a regular grid.

    Parameters
    ----------
    values : (nx, ny, nz) array
        One number for every voxel.
    origin : (3,) array
        Centre of the voxel ``values[0, 0, 0]`` (mm, LPS).
    axes : (3, 3) array
        Its columns lead from one voxel to the next along each index (mm).
    name : str
        What the image is, for messages.
    oriented : bool
        Whether the file said how the subject lies in it.
    unknown : int
        Voxels of the file whose number was not finite; they are 0.
    """

    values: NDArray[Any]
    origin: Array
    axes: Array
    name: str = "image"
    oriented: bool = True
    unknown: int = 0

    @cached_property
    def spacing(self) -> Array:
        """(3,) distances between neighbouring voxels (mm)."""
        return np.asarray(np.linalg.norm(self.axes, axis=0))

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel (mm³)."""
        return float(abs(np.linalg.det(self.axes)))

    def points(self, indices: Array) -> Array:
        """Return the places (n, 3) in mm of indices (n, 3), which need not be whole."""
        return np.asarray(indices @ self.axes.T + self.origin)

    def indices(self, points: Array) -> Array:
        """Return the indices (n, 3), not rounded, of places (n, 3) in mm."""
        return np.asarray(np.linalg.solve(self.axes, (points - self.origin).T).T)

    def shows(self, points: Array) -> NDArray[np.bool_]:
        """Tell which of (n, 3) places are within the field of view."""
        place = self.indices(points)
        high = np.array(self.values.shape) - 1
        return np.asarray(((place >= 0) & (place <= high)).all(axis=1))

    def with_values(self, values: NDArray[Any]) -> Image:
        """Return an image of the same grid."""
        return replace(self, values=values)

    def reduced(self, factors: NDArray[np.int64]) -> Image:
        """Return the means of blocks of voxels.

        Parameters
        ----------
        factors : (3,) int array
            Voxels of a block along each index. What does not fill a block is left out.
        """
        counts = np.array(self.values.shape) // factors
        cut = self.values[tuple(slice(0, n) for n in counts * factors)]
        blocks = cut.reshape(*np.column_stack([counts, factors]).ravel())
        middle = np.asarray(0.5 * (factors - 1.0), dtype=float)
        return replace(
            self,
            values=blocks.mean(axis=(1, 3, 5), dtype=np.float32),
            origin=self.points(middle[None])[0],
            axes=self.axes * factors,
        )


def simpleitk() -> Any:
    """Import SimpleITK.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        import SimpleITK
    except ImportError:
        raise InputError("images: SimpleITK is not installed; run: pip install simpleitk") from None
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    return SimpleITK


def read_image(path: str | Path) -> Image:
    """Read an image and turn it so that its axes run left, backwards and up.

    Parameters
    ----------
    path : path
        A NIfTI (``.nii``, ``.nii.gz``), NRRD or MetaImage file, or a folder with one DICOM series.

    Returns
    -------
    Image
        With the numbers as they are stored; those that are not finite become 0 and are counted.

    Raises
    ------
    InputError
        SimpleITK is not installed, or the file is missing, damaged, truncated, of another kind,
        too large, or does not hold one number for every voxel in three dimensions.
    """
    path = Path(path)
    sitk = simpleitk()
    if path.is_dir():
        reader, unknown = _series(sitk, path), 0
    elif not path.exists():
        raise InputError(f"{path}: no such file; check the path")
    else:
        reader, unknown = _file(sitk, path)
    try:
        read = reader.Execute()
        if read.GetDimension() != 3:
            raise InputError(f"{path}: it has {read.GetDimension()} dimensions; give a volume")
        _check_header(path, read.GetSize(), read.GetSpacing())
        turned = sitk.DICOMOrient(read, "LPS")
    except RuntimeError as error:
        raise _damaged(path, error) from error
    values = sitk.GetArrayFromImage(turned).transpose(2, 1, 0)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        unknown += int((~np.isfinite(values)).sum())
        values = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    spacing = np.array(turned.GetSpacing())
    direction = np.array(turned.GetDirection()).reshape(3, 3)
    # NIfTI says in two codes whether its axes are known; without either they are a guess.
    codes = [
        reader.GetMetaData(key)
        for key in ("qform_code", "sform_code")
        if not path.is_dir() and reader.HasMetaDataKey(key)
    ]
    oriented = not codes or any(code.strip() not in ("", "0") for code in codes)
    origin = np.array(turned.GetOrigin())
    return Image(values, origin, direction * spacing, path.name, oriented, unknown)


def write_image(path: str | Path, image: Image) -> None:
    """Write an image as NIfTI or NRRD, whichever the name of the file says.

    Raises
    ------
    InputError
        SimpleITK is not installed.
    OSError
        The file cannot be written.
    """
    sitk = simpleitk()
    out = sitk.GetImageFromArray(np.ascontiguousarray(image.values.transpose(2, 1, 0)))
    out.SetSpacing(image.spacing.tolist())
    out.SetOrigin(image.origin.tolist())
    out.SetDirection((image.axes / image.spacing).ravel().tolist())
    try:
        sitk.WriteImage(out, str(path), useCompression=True)
    except RuntimeError as error:
        raise OSError(None, "the image cannot be written", str(path)) from error


def _damaged(path: Path, error: RuntimeError) -> InputError:
    if "orthonormal" in str(error):
        return InputError(f"{path}: its axes are not at right angles; resample the image")
    return InputError(f"{path}: cannot be read as an image; it may be damaged, fetch it again")


def _check_header(path: Path, size: tuple[int, ...], spacing: tuple[float, ...]) -> None:
    """Refuse a grid that is no volume, too large, or of voxels that no scanner makes."""
    grid = " × ".join(str(n) for n in size)
    if len(size) != 3 or min(size) < _SHORTEST:
        raise InputError(f"{path}: {grid} voxels are no volume of a head; give a 3-D image")
    if max(size) > _LONGEST or int(np.prod(np.array(size, dtype=object))) > _MOST_VOXELS:
        raise InputError(
            f"{path}: {grid} voxels are more than {_MOST_VOXELS >> 20} Mi; cut or resample it"
        )
    low, high = _SPACINGS
    if not all(low <= step <= high for step in spacing):
        steps = " × ".join(f"{step:.3g}" for step in spacing)
        raise InputError(f"{path}: voxels of {steps} mm; give an image with its spacing in mm")


def _file(sitk: Any, path: Path) -> tuple[Any, int]:
    """Return a reader for one file, its header checked, and how many numbers it will lose."""
    if not path.name.lower().endswith(_FILES):
        raise InputError(
            f"{path}: not an image; give one of {', '.join(_FILES)}, or a DICOM series' folder"
        )
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; fetch it again")
    unknown = _check_nifti(path) if ".nii" in path.name.lower() else 0
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise _damaged(path, error) from error
    if reader.GetNumberOfComponents() != 1:
        count = reader.GetNumberOfComponents()
        raise InputError(f"{path}: {count} numbers for every voxel; give a grey image")
    _check_header(path, reader.GetSize(), reader.GetSpacing())
    return reader, unknown


def _check_nifti(path: Path) -> int:
    """Check dimensions and length of a NIfTI file; a truncated one would be read in part.

    Of a compressed file no more than its header promises is unpacked, and little at once.

    Returns
    -------
    int
        How many of its numbers are not finite: the reader turns them to 0 without a word.
    """
    unknown = 0
    short = InputError(f"{path}: shorter than its header says; it is truncated, fetch it again")
    packed = path.name.lower().endswith(".gz")
    try:
        with gzip.open(path) if packed else path.open("rb") as file:
            header = file.read(352)
            if len(header) < 348:
                raise short
            order = "<" if struct.unpack("<i", header[:4])[0] == 348 else ">"
            if struct.unpack(order + "i", header[:4])[0] != 348:
                raise InputError(f"{path}: not a NIfTI-1 file; write it anew")
            dim = struct.unpack(order + "8h", header[40:56])
            bits = struct.unpack(order + "h", header[72:74])[0]
            start = struct.unpack(order + "f", header[108:112])[0]
            rank, size = dim[0], list(dim[1:])
            grid = " × ".join(str(n) for n in size[: max(rank, 0)])
            if not 1 <= rank <= 7 or min(size[:rank]) < 1:
                raise InputError(f"{path}: its header is damaged; fetch the image again")
            if rank < 3 or any(n > 1 for n in size[3:rank]):
                raise InputError(
                    f"{path}: {grid} voxels; give one image in three dimensions, no slice or series"
                )
            _check_header(path, tuple(size[:3]), (1.0, 1.0, 1.0))
            if not (0 < bits <= 128 and 0.0 <= start < 2**24):
                raise InputError(f"{path}: its header is damaged; fetch the image again")
            kind = _NIFTI_FLOATS.get((struct.unpack(order + "h", header[70:72])[0], bits))
            ahead = int(start) - len(header)
            if ahead > 0 and len(file.read(ahead)) < ahead:
                raise short
            left = int(np.prod(size[:3])) * bits // 8 + min(ahead, 0)
            while left > 0:
                block = file.read(min(left, _CHUNK))
                if len(block) < min(left, _CHUNK):
                    raise short
                left -= len(block)
                if kind is not None:
                    numbers = np.frombuffer(block, order + kind, len(block) // (bits // 8))
                    unknown += int((~np.isfinite(numbers)).sum())
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise short from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the file") from error
    return unknown


def _series(sitk: Any, folder: Path) -> Any:
    """Return a reader for the one DICOM series in a folder, its slices checked."""
    if sum(1 for _ in folder.iterdir()) > _MOST_FILES:
        raise InputError(f"{folder}: more than {_MOST_FILES} files; give the folder of one series")
    found = sitk.ImageSeriesReader.GetGDCMSeriesIDs(str(folder))
    if not found:
        raise InputError(f"{folder}: no DICOM series in it; give an image or another folder")
    if len(found) > 1:
        raise InputError(f"{folder}: {len(found)} DICOM series in it; leave one")
    names = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), found[0])
    reader = sitk.ImageFileReader()
    places = []
    try:
        for name in names:
            reader.SetFileName(name)
            reader.ReadImageInformation()
            size = reader.GetSize()
            if len(names) > 1:
                size = (*size[:2], len(names))
            if reader.GetNumberOfComponents() != 1:
                raise InputError(f"{folder}: a series in colour; give a grey one")
            _check_header(folder, size, reader.GetSpacing()[:3])
            places.append(reader.GetOrigin())
    except RuntimeError as error:
        raise _damaged(folder, error) from error
    gaps = np.linalg.norm(np.diff(np.array(places), axis=0), axis=1)
    if len(gaps) and gaps.max() > 1.05 * gaps.min() + 0.02:
        raise InputError(
            f"{folder}: its slices are {gaps.min():.2f} to {gaps.max():.2f} mm apart; "
            "one may be missing, export the series again"
        )
    series = sitk.ImageSeriesReader()
    series.SetFileNames(names)
    return series
