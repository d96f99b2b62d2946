"""EX files: what is written is read, by us and by Zinc; what is damaged is refused."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from modiolus.cli import main
from modiolus.errors import InputError
from modiolus.face.head import Head
from modiolus.hermite import HermiteMesh, grid, linear
from modiolus.hermite.ex import write_ex
from modiolus.hermite.exread import read_ex
from modiolus.scans.result import save_state

RNG = np.random.default_rng(4)
#: Zinc and we evaluate the same polynomial in another order of operations (mm).
AGREE = 1e-10


@pytest.fixture(scope="module")
def head() -> Head:
    return Head.load("taro")


def block() -> HermiteMesh:
    axes = np.meshgrid(np.arange(3.0), np.arange(3.0), np.arange(2.0), indexing="ij")
    points = 5.0 * np.stack(axes, axis=-1)
    mesh = grid(points)
    return mesh.with_parameters(mesh.parameters + 0.3 * RNG.normal(size=mesh.parameters.shape))


def collapsed() -> HermiteMesh:
    """Two wedges: an edge has collapsed, and derivatives are differences of positions."""
    cells = np.array([[0, 0, 2, 3, 4, 4, 6, 7], [4, 4, 6, 7, 8, 8, 10, 11]])
    return linear(RNG.normal(size=(12, 3)), cells)


def scaled() -> HermiteMesh:
    """A row of elements of unequal length: derivatives by arc length, with scale factors."""
    mesh = block()
    factors = RNG.uniform(0.5, 2.0, (mesh.n_elements, 3))
    bits = np.arange(8)[:, None] >> np.arange(3) & 1
    scales = np.prod(factors[:, None, :] ** bits, axis=2)
    rows = np.broadcast_to(scales[:, None, :], (mesh.n_elements, 8, 8)).ravel()
    return HermiteMesh(3, mesh.parameters, sp.csr_matrix(sp.diags_array(rows) @ mesh.extraction))


def samples(mesh: HermiteMesh, count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    return RNG.integers(0, mesh.n_elements, count), RNG.random((count, mesh.dim))


def meshes(head: Head) -> dict[str, HermiteMesh]:
    return {
        "block": block(),
        "collapsed": collapsed(),
        "half": head.tissue,  # versions at the ends of the slits
        "whole": head.whole.tissue,
        "scaled": scaled(),
        "surface": head.tissue.face(*head.sides["outer"]),
        "curve": head.tissue.face(*head.sides["outer"]).face(np.arange(12), 1, 0),
    }


@pytest.mark.parametrize("suffix", [".exf", ".exnode"])
@pytest.mark.parametrize(
    "name", ["block", "collapsed", "half", "whole", "scaled", "surface", "curve"]
)
def test_what_is_written_is_read(tmp_path: Path, head: Head, name: str, suffix: str) -> None:
    mesh = meshes(head)[name]
    path = tmp_path / f"mesh{suffix}"
    other = mesh.parameters + RNG.normal(size=mesh.parameters.shape)
    write_ex(path, mesh, {"deformed": other}, groups={"some": [1, 0]}, first=(101, 31))
    found = read_ex(path)
    elements, xi = samples(mesh)
    # Numbers are written with all their digits.
    scale = np.abs(mesh.parameters).max()
    assert np.abs(found.mesh.evaluate(elements, xi) - mesh.evaluate(elements, xi)).max() < (
        1e-14 * scale
    )
    moved = mesh.functions(elements, xi) @ other
    assert np.abs(found.fields["deformed"].evaluate(elements, xi) - moved).max() < 1e-14 * scale
    assert found.groups["some"].tolist() == [0, 1]
    assert found.identifiers.tolist() == list(range(31, 31 + mesh.n_elements))
    # The deformed mesh is the mesh with other parameters.
    there = found.mesh.with_parameters(found.fields["deformed"].parameters)
    assert np.abs(there.evaluate(elements, xi) - moved).max() < 1e-14 * scale


def test_slit_ends_are_versions_and_nothing_is_lost(tmp_path: Path, head: Head) -> None:
    write_ex(tmp_path / "a.exf", head.tissue)
    text = (tmp_path / "a.exf").read_text()
    assert "d/ds1(3)" in text
    assert "Scale factors:" not in text
    assert read_ex(tmp_path / "a.exf").mesh.n_params == head.tissue.n_params
    mesh = scaled()
    write_ex(tmp_path / "b.exf", mesh)
    assert "Scale factors:" in (tmp_path / "b.exf").read_text()
    assert read_ex(tmp_path / "b.exf").mesh.n_params == mesh.n_params


@pytest.mark.parametrize("suffix", [".exf", ".exnode"])
def test_zinc_reads_the_same_fields(tmp_path: Path, head: Head, suffix: str) -> None:
    zinc = pytest.importorskip("cmlibs.zinc.context", reason="cmlibs.zinc is not installed")
    for name, mesh in meshes(head).items():
        path = tmp_path / f"{name}{suffix}"
        other = mesh.parameters + RNG.normal(size=mesh.parameters.shape)
        write_ex(path, mesh, {"deformed": other})
        region = in_zinc(zinc, path)
        elements, xi = samples(mesh, 200)
        seen = evaluated(region, "coordinates", elements, xi)
        assert np.abs(seen - mesh.evaluate(elements, xi)).max() < AGREE, name
        seen = evaluated(region, "deformed", elements, xi)
        assert np.abs(seen - mesh.functions(elements, xi) @ other).max() < AGREE, name


def test_we_read_what_zinc_writes(tmp_path: Path, head: Head) -> None:
    zinc = pytest.importorskip("cmlibs.zinc.context", reason="cmlibs.zinc is not installed")
    for name, mesh in meshes(head).items():
        write_ex(tmp_path / "ours.exf", mesh)
        region = in_zinc(zinc, tmp_path / "ours.exf")
        region.getFieldmodule().defineAllFaces()
        theirs = tmp_path / "theirs.exf"
        region.writeFile(str(theirs))
        assert theirs.read_text().startswith("EX Version: 3")
        elements, xi = samples(mesh)
        gap = read_ex(theirs).mesh.evaluate(elements, xi) - mesh.evaluate(elements, xi)
        assert np.abs(gap).max() < AGREE, name


@pytest.mark.parametrize("suffix", [".exf", ".exnode"])
def test_zinc_sees_the_same_fibres(tmp_path: Path, head: Head, suffix: str) -> None:
    zinc = pytest.importorskip("cmlibs.zinc.context", reason="cmlibs.zinc is not installed")
    muscle = head.muscles["buccinator"]
    angles = 0.4 * RNG.normal(size=(muscle.mesh.n_params // 8, 3))
    muscle = replace(muscle, angles=angles)
    path = tmp_path / f"muscle{suffix}"
    write_ex(path, muscle.mesh, linear={"fibres": angles[muscle.corners]})
    module = in_zinc(zinc, path).getFieldmodule()
    fields = [module.findFieldByName(name) for name in ("fibres", "coordinates")]
    axes = module.createFieldFibreAxes(*fields)
    elements, xi = samples(muscle.mesh, 100)
    seen = evaluated(module.getRegion(), axes, elements, xi, 9).reshape(-1, 3, 3)
    # Fibre, sheet and normal: the conventions of the three angles agree.
    assert np.abs(seen - muscle.frame(elements, xi)).max() < AGREE
    ours = read_ex(path).fields["fibres"].evaluate(elements, xi)
    corners = np.stack(
        [np.where(np.arange(8)[:, None] >> k & 1, xi[:, k], 1.0 - xi[:, k]) for k in range(3)]
    ).prod(axis=0)
    expected = np.einsum("cn,nck->nk", corners, angles[muscle.corners[elements]])
    assert np.abs(ours - expected).max() < 1e-14


def test_lagrange_and_mixed_elements_are_read_exactly(tmp_path: Path) -> None:
    zinc = pytest.importorskip("cmlibs.zinc.context", reason="cmlibs.zinc is not installed")
    from cmlibs.zinc.element import Element, Elementbasis
    from cmlibs.zinc.node import Node

    hermite = Elementbasis.FUNCTION_TYPE_CUBIC_HERMITE
    lines, parabolas, cubics = (
        Elementbasis.FUNCTION_TYPE_LINEAR_LAGRANGE,
        Elementbasis.FUNCTION_TYPE_QUADRATIC_LAGRANGE,
        Elementbasis.FUNCTION_TYPE_CUBIC_LAGRANGE,
    )
    labels = [getattr(Node, f"VALUE_LABEL_{kind}") for kind in ("VALUE", "D_DS1", "D_DS2")]
    labels += [Node.VALUE_LABEL_D2_DS1DS2]
    for kinds in [(hermite, hermite, lines), (cubics, parabolas, lines), (lines, hermite)]:
        CONTEXTS.append(zinc.Context("mixed"))
        region = CONTEXTS[-1].getDefaultRegion()
        module = region.getFieldmodule()
        field = module.createFieldFiniteElement(3)
        field.setName("coordinates")
        field.setTypeCoordinate(True)
        nodes = module.findNodesetByName("nodes")
        template = nodes.createNodetemplate()
        template.defineField(field)
        for label in labels:
            template.setValueNumberOfVersions(field, -1, label, 1)
        mesh = module.findMeshByDimension(len(kinds))
        basis = module.createElementbasis(len(kinds), lines)
        for k, kind in enumerate(kinds):
            basis.setFunctionType(k + 1, kind)
        how = mesh.createElementfieldtemplate(basis)
        cache = module.createFieldcache()
        count = how.getNumberOfLocalNodes()
        for number in range(count):
            cache.setNode(nodes.createNode(number + 1, template))
            for label in labels:
                field.setNodeParameters(cache, -1, label, 1, RNG.normal(size=3).tolist())
        elements = mesh.createElementtemplate()
        shape = Element.SHAPE_TYPE_CUBE if len(kinds) == 3 else Element.SHAPE_TYPE_SQUARE
        elements.setElementShapeType(shape)
        elements.defineField(field, -1, how)
        mesh.createElement(1, elements).setNodesByIdentifier(how, list(range(1, count + 1)))
        path = tmp_path / "mixed.exf"
        region.writeFile(str(path))
        found = read_ex(path).mesh
        places = samples(found, 50)
        gap = found.evaluate(*places) - evaluated(region, "coordinates", *places)
        assert np.abs(gap).max() < 1e-12


#: A region does not keep its context alive.
CONTEXTS: list[Any] = []


def in_zinc(zinc: Any, path: Path) -> Any:
    CONTEXTS.append(zinc.Context("test"))
    region = CONTEXTS[-1].getDefaultRegion()
    pair = [path] if path.suffix == ".exf" else [path, path.with_suffix(".exelem")]
    assert all(region.readFile(str(file)) == 1 for file in pair)
    return region


def evaluated(
    region: Any, field: Any, elements: np.ndarray, xi: np.ndarray, components: int = 3
) -> np.ndarray:
    module = region.getFieldmodule()
    chosen = module.findFieldByName(field) if isinstance(field, str) else field
    mesh = module.findMeshByDimension(xi.shape[1])
    cache = module.createFieldcache()
    out = []
    for element, place in zip(elements.tolist(), xi.tolist(), strict=True):
        cache.setMeshLocation(mesh.findElementByIdentifier(element + 1), place)
        done, values = chosen.evaluateReal(cache, components)
        assert done == 1
        out.append(values)
    return np.array(out)


# The command


@pytest.mark.parametrize("sides", ["half", "whole"])
def test_a_result_is_exported_with_its_muscles(
    tmp_path: Path, head: Head, sides: str, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = head if sides == "half" else head.whole
    turn = np.array([[1.0, 0.02, 0.0], [0.0, 0.97, 0.01], [0.0, 0.0, 1.05]])
    state = chosen.tissue.parameters @ turn.T
    (tmp_path / "run").mkdir()
    pressure = np.zeros(len(chosen.tissue.corner_nodes()[1]))
    save_state(tmp_path / "run/state.npz", "test", head, "taro", state, pressure, {}, 0.0)
    with pytest.raises(SystemExit) as left:
        main(["export", str(tmp_path / "run"), "--ex", str(tmp_path / "ex"), "--json"])
    assert left.value.code == 0
    record = json.loads(capsys.readouterr().out)
    assert record["muscles"] == list(chosen.muscles)
    tissue, muscles = (read_ex(record["files"][part]) for part in ("tissue", "muscles"))
    places = samples(chosen.tissue)
    seen = tissue.fields["deformed"].evaluate(*places)
    assert np.allclose(seen, chosen.tissue.functions(*places) @ state, atol=1e-9)
    assert list(muscles.groups) == list(chosen.muscles)
    assert not set(tissue.identifiers) & set(muscles.identifiers)
    # The tissue has been turned and stretched evenly, and its muscles with it.
    elements, xi = samples(muscles.mesh)
    rest = muscles.mesh.evaluate(elements, xi)
    inside = chosen.tissue.locate(rest).distance < 1e-6
    moved = muscles.fields["deformed"].evaluate(elements, xi)
    # Where a muscle leaves the tissue it goes with the nearest point.
    gap = np.linalg.norm(moved - rest @ turn.T, axis=1)
    assert inside.mean() > 0.8
    assert np.median(gap[inside]) < 1e-4
    assert "CC" in (tmp_path / "ex/LICENSE").read_text()


def test_the_command_says_what_it_lacks(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["export", "taro"])
    assert left.value.code == 2
    assert "--ex" in capsys.readouterr().err


# What is damaged


@pytest.mark.parametrize("suffix", [".exf", ".exnode", ".exelem"])
def test_truncated_files_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"mesh{suffix}"
    write_ex(path, block())
    data = path.read_bytes()
    for share in (0.05, 0.3, 0.5, 0.7, 0.9):
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(InputError) as error:
            read_ex(path)
        one_line(error.value, "mesh")


def test_changed_words_never_end_in_another_error(tmp_path: Path) -> None:
    """Damage by chance: a refusal in one line, or a mesh that differs."""
    path = tmp_path / "mesh.exf"
    for suffix in (".exf", ".exnode"):
        write_ex(path.with_suffix(suffix), block(), linear={"t": np.ones((4, 8, 1))})
    for suffix in (".exf", ".exnode", ".exelem"):
        file = path.with_suffix(suffix)
        original = file.read_text()
        words = original.split(" ")
        refused = 0
        for _ in range(120):
            damaged = list(words)
            where = int(RNG.integers(len(words)))
            damaged[where] = str(RNG.choice(["-7", "99999999999", "nan", "1e400", "x", "", "0"]))
            file.write_text(" ".join(damaged))
            try:
                read_ex(file)
            except InputError as error:
                one_line(error, "mesh")
                refused += 1
        assert refused > 20
        file.write_text(original)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("#Components=3", "#Components=999999999", "more than"),
        ("#Values=8", "#Values=9", "announced"),
        ("#Nodes=8", "#Nodes=7", "announced|local node"),
        (" Nodes:\n 1 ", " Nodes:\n 77777 ", "77777"),
        ("Version: 2", "Version: 9", "not known"),
        ("c.Hermite*c.Hermite*c.Hermite", "l.simplex(2;3)*l.simplex*l.simplex", "interpolated by"),
        ("rectangular cartesian", "prolate spheroidal", "rectangular"),
        ("standard node based", "grid based", "grid"),
        ("d3/ds1ds2ds3\n", "d/ds9\n", "d/ds9"),
        ("real, #Components=3\n x. #Values", "real, #Components=0\n x. #Values", "no components"),
    ],
)
def test_wrong_counts_and_forms_are_told(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "mesh.exf"
    write_ex(path, block())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=said) as error:
        read_ex(path)
    one_line(error.value, "mesh.exf")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"fields": {"f": np.zeros((3, 1))}}, r"f: shape \(3, 1\)"),
        ({"fields": {"f": np.full((2, 1), np.nan)}}, "f: .*NaN"),
        ({"fields": {"a, b": np.zeros((2, 1))}}, "no name"),
        ({"fields": {"coordinates": np.zeros((2, 3))}}, "another field"),
        ({"linear": {"f": np.zeros((1, 2))}}, "f: shape"),
        ({"groups": {"g": [1]}}, "g: 1 is not"),
        ({"groups": {"g": [-1]}}, "g: -1 is not"),
        ({"groups": {"a\nb": [0]}}, "no name"),
        ({"first": (0, 1)}, "first"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path: Path, more: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        write_ex(tmp_path / "line.exf", linear(np.eye(3)[:2], [[0, 1]]), **more)
    assert not list(tmp_path.iterdir())


def test_names_without_end_are_refused_at_once(tmp_path: Path) -> None:
    """A small file that would unpack to twenty million values."""
    path = tmp_path / "bomb.exf"
    names = "value(1024)," * 20_000 + "value"
    path.write_text(
        "EX Version: 2\n!#nodeset nodes\nShape. Dimension=0\n#Fields=1\n"
        f"1) a, field, real, #Components=1\n x. #Values=3 ({names})\nNode: 1\n"
    )
    tracemalloc.start()
    with pytest.raises(InputError, match="more than 1024 values") as error:
        read_ex(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    one_line(error.value, "bomb.exf")
    assert peak < 20e6


def test_other_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = {
        "empty.exf": b"",
        "binary.exf": bytes(range(256)) * 10,
        "points.exf": b"EX Version: 2\nRegion: /\n",
        "other.txt": b"hello",
    }
    for name, data in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError) as error:
            read_ex(tmp_path / name)
        one_line(error.value, name)
    with pytest.raises(InputError, match="cannot be read"):
        read_ex(tmp_path / "missing.exf")
    write_ex(tmp_path / "lonely.exnode", block())
    (tmp_path / "lonely.exelem").unlink()
    with pytest.raises(InputError, match=r"lonely\.exelem"):
        read_ex(tmp_path / "lonely.exnode")
    monkeypatch.setattr("modiolus.hermite.exread.LARGEST", 10)
    write_ex(tmp_path / "large.exf", block())
    with pytest.raises(InputError, match="larger than"):
        read_ex(tmp_path / "large.exf")


def one_line(error: InputError, name: str) -> None:
    text = str(error)
    assert "\n" not in text
    assert name in text
    assert ";" in text
