"""Images: reading them safely, the skin in them, and label maps."""

import gzip
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

pytest.importorskip("SimpleITK", reason="the extra [images] is not installed")

from modiolus.anatomy.image import Image, read_image, write_image
from modiolus.anatomy.labels import label_surfaces, read_label_names, write_labels
from modiolus.anatomy.segment import outer_skin, segment_skin
from modiolus.anatomy.surface import Surface, read_surface
from modiolus.cli import _run
from modiolus.errors import InputError

#: Half axes (mm) of the head of the tests, an ellipsoid.
AXES = np.array([72.0, 92.0, 100.0])


def ellipsoid(spacing: float, noise: float = 0.02, ghost: float = 0.0) -> Image:
    """A bright ellipsoid with a cavity, shaded and noisy, cut by the lower end of the image."""
    low, high = np.array([-90.0, -112.0, -80.0]), np.array([90.0, 112.0, 118.0])
    shape = np.round((high - low) / spacing).astype(int)
    axes = [low[k] + spacing * np.arange(shape[k]) for k in range(3)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    fine = np.sqrt((x / AXES[0]) ** 2 + (y / AXES[1]) ** 2 + (z / AXES[2]) ** 2)
    slope = np.sqrt((x / AXES[0] ** 2) ** 2 + (y / AXES[1] ** 2) ** 2 + (z / AXES[2] ** 2) ** 2)
    distance = (fine - 1.0) * fine / np.maximum(slope, 1e-9)
    body = np.clip(0.5 - distance / spacing, 0.0, 1.0)
    body[x**2 + y**2 + z**2 < 20.0**2] = 0.0
    # A canal from the front, 6 mm wide, as a nostril is.
    body[(x**2 + z**2 < 3.0**2) & (y < -40.0)] = 0.0
    body = gaussian_filter(body, 0.3)
    shade = 1.0 + 0.3 * x / 90.0 - 0.2 * z / 100.0
    rng = np.random.default_rng(1)
    channels = noise * rng.standard_normal((2, *shape))
    ghosts = ghost * (np.abs(y + 104.0) < 4.0)
    channels[0] += body * shade + ghosts
    values = 800.0 * np.hypot(*channels)
    return Image(values.astype(np.float32), low, spacing * np.eye(3), "ellipsoid")


def off(points: np.ndarray) -> np.ndarray:
    """First-order distance (mm) of points to the ellipsoid."""
    level = np.sqrt(((points / AXES) ** 2).sum(axis=1))
    return (level - 1.0) * level / np.linalg.norm(points / AXES**2, axis=1)


def test_the_skin_of_an_ellipsoid_is_found_between_the_voxels() -> None:
    found = segment_skin(ellipsoid(2.0, ghost=0.12))
    points = found.surface.vertices
    canal = (points[:, 0] ** 2 + points[:, 2] ** 2 < 9.0**2) & (points[:, 1] < 0.0)
    # A twentieth of a voxel in the mean, a tenth everywhere.
    assert np.sqrt(np.mean(off(points[~canal]) ** 2)) < 0.2
    # The canal ends in a lid, and the cavity behind it is no surface.
    assert off(points[canal]).min() > -8.0
    assert len(found.surface.components()) == 1
    assert set(found.cuts) == {"bottom"}
    assert found.cuts["bottom"] == pytest.approx(
        np.pi * AXES[0] * AXES[1] * (1.0 - 0.8**2), rel=0.05
    )
    assert (found.surface.normals * found.surface.vertices[found.surface.faces[:, 0]]).sum() > 0.0


@pytest.mark.parametrize(
    ("fat", "blur", "expected", "within"),
    [(1.0, 0.5, 24.0, 0.1), (0.6, 0.5, 24.0, 0.15), (1.0, 2.0, 23.7, 1e-6)],
)
def test_the_skin_lies_before_the_dermis_where_that_shows(
    fat: float, blur: float, expected: float, within: float
) -> None:
    """A ball of 24 mm with a dermis of 0.6: sharp, without fat beneath it, and blurred."""
    import pyvista as pv

    fine = 0.5
    ticks = np.arange(-32.0, 32.0, fine)
    radius = np.sqrt(sum(t**2 for t in np.meshgrid(ticks, ticks, ticks, indexing="ij")))
    layers = [np.clip(0.5 + (r - radius) / fine, 0.0, 1.0) for r in (24.0, 22.5)]
    values = 1000.0 * gaussian_filter(0.6 * layers[0] + (fat - 0.6) * layers[1], blur / fine)
    values += np.random.default_rng(5).normal(0.0, 5.0, values.shape)
    image = Image(values.astype("f4"), np.full(3, ticks[0]), fine * np.eye(3)).reduced(
        np.array([2, 2, 2])
    )
    ball = pv.Icosphere(radius=23.7, nsub=4)
    found = outer_skin(image, Surface(ball.points, ball.regular_faces), 0.0)
    size = np.linalg.norm(found.vertices, axis=1)
    assert size.mean() == pytest.approx(expected, abs=within)
    assert np.std(size) < 0.06


def test_an_oblique_image_stored_in_any_order_gives_the_same_place(tmp_path: Path) -> None:
    import SimpleITK as sitk

    straight = ellipsoid(4.0)
    turn = Rotation.from_euler("xyz", [8.0, -5.0, 12.0], degrees=True).as_matrix()
    turned = Image(straight.values, turn @ straight.origin, turn @ straight.axes, "turned")
    write_image(tmp_path / "a.nii.gz", turned)
    stored = sitk.DICOMOrient(sitk.ReadImage(str(tmp_path / "a.nii.gz")), "PIR")
    sitk.WriteImage(stored, str(tmp_path / "b.nrrd"))
    again = read_image(tmp_path / "b.nrrd")
    np.testing.assert_allclose(again.axes, turned.axes, atol=1e-5)
    np.testing.assert_allclose(again.origin, turned.origin, atol=1e-3)
    np.testing.assert_array_equal(again.values, turned.values)


def test_a_dicom_series_is_read_and_a_missing_slice_is_told(tmp_path: Path) -> None:
    import SimpleITK as sitk

    values = np.arange(10 * 16 * 12, dtype=np.int16).reshape(10, 16, 12)
    for k in range(10):
        part = sitk.GetImageFromArray(values[k : k + 1])
        part.SetSpacing((1.5, 1.5, 2.0))
        part.SetOrigin((-9.0, 4.0, 30.0 + 2.0 * k))
        tags = {
            "0008|0060": "MR",
            "0020|000e": "1.2.3.4",
            "0020|000d": "1.2.3",
            "0020|0013": str(k + 1),
            "0020|0032": f"-9\\4\\{30.0 + 2.0 * k}",
            "0020|0037": "1\\0\\0\\0\\1\\0",
        }
        for key, value in tags.items():
            part.SetMetaData(key, value)
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.SetFileName(str(tmp_path / f"{k:02d}.dcm"))
        writer.Execute(part)
    image = read_image(tmp_path)
    np.testing.assert_allclose(image.origin, [-9.0, 4.0, 30.0])
    np.testing.assert_allclose(image.spacing, [1.5, 1.5, 2.0])
    np.testing.assert_array_equal(image.values, values.transpose(2, 1, 0))
    (tmp_path / "05.dcm").unlink()
    with pytest.raises(InputError, match="apart"):
        read_image(tmp_path)


def nifti(path: Path, dim: tuple[int, ...], data: bytes) -> Path:
    header = bytearray(352)
    header[0:4] = struct.pack("<i", 348)
    header[40 : 40 + 2 * len(dim)] = struct.pack(f"<{len(dim)}h", *dim)
    header[70:74] = struct.pack("<2h", 4, 16)
    header[76:92] = struct.pack("<4f", 1.0, 1.0, 1.0, 1.0)
    header[108:112] = struct.pack("<f", 352.0)
    header[344:348] = b"n+1\0"
    content = bytes(header) + data
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path


@pytest.mark.parametrize(
    ("dim", "size", "fault"),
    [
        ((3, 16, 16, 16, 1, 1, 1, 1), 100, "truncated"),
        ((3, 30000, 30000, 30000, 1, 1, 1, 1), 100, "more than"),
        ((2, 64, 64, 1, 1, 1, 1, 1), 8192, "three dimensions"),
        ((3, 64, 64, 1, 1, 1, 1, 1), 8192, "no volume"),
        ((4, 16, 16, 16, 5, 1, 1, 1), 40960, "three dimensions"),
        ((3, -5, 16, 16, 1, 1, 1, 1), 100, "damaged"),
        ((3, 32, 32, 32, 1, 1, 1, 1), 65536, "no contrast"),
    ],
)
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_bad_images_give_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    dim: tuple[int, ...],
    size: int,
    fault: str,
    suffix: str,
) -> None:
    path = nifti(tmp_path / f"bad{suffix}", dim, bytes(size))
    assert _run(["segment", str(path), "--out", str(tmp_path / "out"), "-q"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and str(path.name) in message and fault in message
    assert not (tmp_path / "out").exists()


def test_what_is_no_image_gives_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = tmp_path / "whole.nii.gz"
    write_image(whole, ellipsoid(8.0))
    content = whole.read_bytes()
    bomb = gzip.compress(bytes(2**26))
    cases = {
        "cut.nii.gz": content[: len(content) // 2],
        "empty.nii.gz": b"",
        "words.nii": b"hello" * 200,
        "words.nii.gz": b"hello" * 200,
        "bomb.nii.gz": bomb,
        "words.nrrd": b"NRRD0004\ntype: float\ndimension: 3\nsizes: 9999 9999 9999\n\n",
        "short.nrrd": b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 20 20 20\nencoding: raw\n\nab",
        "text.txt": b"x",
    }
    paths = [tmp_path / name for name in cases]
    for path, data in zip(paths, cases.values(), strict=True):
        path.write_bytes(data)
    (tmp_path / "folder").mkdir()
    for path in [*paths, tmp_path / "folder", tmp_path / "missing.nii"]:
        assert _run(["segment", str(path), "--out", str(tmp_path / "out"), "-q"]) == 2, path
        message = capsys.readouterr().err
        assert message.count("\n") == 1 and path.name in message, message
    assert not (tmp_path / "out").exists()


def test_an_image_without_a_face_is_refused_and_holes_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("modiolus.scans.shown.find_face", lambda found, head: None)
    image = ellipsoid(3.0)
    values = image.values.copy()
    values[:3, :2, 0] = np.nan
    write_image(tmp_path / "egg.nii.gz", image.with_values(values))
    assert read_image(tmp_path / "egg.nii.gz").unknown == 6
    command = ["segment", str(tmp_path / "egg.nii.gz"), "--out", str(tmp_path / "out"), "-q"]
    assert _run(command) == 2
    assert "no face found" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_is_no_head_is_refused() -> None:
    rng = np.random.default_rng(2)
    noise = Image(rng.rayleigh(1.0, (40, 40, 40)).astype("f4"), np.zeros(3), 4.0 * np.eye(3))
    with pytest.raises(InputError):
        segment_skin(noise)
    small = ellipsoid(4.0)
    with pytest.raises(InputError, match="no head"):
        segment_skin(Image(small.values, small.origin / 4.0, small.axes / 4.0, "small"))


def test_labels_become_surfaces_of_the_same_volume(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shape = (60, 50, 40)
    x, y, z = np.meshgrid(*(np.arange(n) - n / 2 for n in shape), indexing="ij")
    values = np.zeros(shape, dtype=np.int16)
    values[(x / 24) ** 2 + (y / 16) ** 2 + (z / 10) ** 2 < 1.0] = 7
    # A sheet of two voxels that the end of the image cuts.
    values[:, 4:6, 5:30] = 2
    turn = Rotation.from_euler("z", 20.0, degrees=True).as_matrix()
    labels = Image(values, np.array([10.0, -20.0, 5.0]), turn, "labels")
    write_labels(tmp_path, labels, {"belly": 7, "sheet": 2})
    names = read_label_names(tmp_path / "labels.toml")
    assert names == {"belly": 7, "sheet": 2}
    out = tmp_path / "out"
    command = ["segment", str(tmp_path / "labels.nii.gz"), "--out", str(out), "--json"]
    assert _run([*command, "--labels", str(tmp_path / "labels.toml")]) == 0
    record = json.loads(capsys.readouterr().out)
    for name, number in names.items():
        surface = read_surface(out / f"{name}.ply")
        assert surface.volume == pytest.approx(float((values == number).sum()), rel=0.02)
        assert record["structures"][name]["volume_mm3"] == pytest.approx(surface.volume, rel=1e-3)
    centre = read_surface(out / "belly.ply").bounds.mean(axis=0)
    np.testing.assert_allclose(centre, labels.points(np.array([[30.0, 25.0, 20.0]]))[0], atol=0.3)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[structures]\na = 0\n", "whole number"),
        ("[structures]\na = 1\nb = 1\n", "same number"),
        ('[structures]\n"../a" = 1\n', "no name"),
        ("a = 1\n", "structures"),
        ("[structures\n", "TOML"),
    ],
)
def test_bad_tables_of_names_are_refused(tmp_path: Path, text: str, fault: str) -> None:
    path = tmp_path / "names.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=fault):
        read_label_names(path)
    with pytest.raises(InputError, match="voxels"):
        label_surfaces(Image(np.zeros((9, 9, 9), "i2"), np.zeros(3), np.eye(3)), {"a": 3})


@pytest.mark.slow
def test_the_skin_in_a_simulated_image_of_the_head() -> None:
    from modiolus.face.head import Head
    from modiolus.face.phantom import simulated_t1, skin_error
    from modiolus.scans.shown import find_face

    head = Head.load("taro")
    phantom = simulated_t1(head)
    found = segment_skin(phantom.image)
    error = skin_error(phantom, found.surface)
    assert np.sqrt(np.mean(error**2)) < 0.2
    assert np.percentile(error, 95) < 0.35
    face = find_face(found, head)
    assert face is not None and face.distance < 0.5
    assert face.pose.scale == pytest.approx(1.0, abs=0.01)
    assert not face.missing
    names = {"orbicularis_oris_upper_left": phantom.names["orbicularis_oris_upper_left"]}
    surface = label_surfaces(phantom.labels, names)["orbicularis_oris_upper_left"]
    truth = phantom.muscles["orbicularis_oris_upper_left"]
    assert surface.volume == pytest.approx(truth.volume, rel=0.06)
    assert np.sqrt(np.mean(surface.closest(truth.vertices).distance ** 2)) < 0.5
