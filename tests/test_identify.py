"""Unknowns found from what was measured: slopes, targets, markers, and the search."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pygltflib
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from modiolus.anatomy.surface import Surface
from modiolus.cli import main
from modiolus.errors import InputError, SolveError
from modiolus.face.expression import Expression
from modiolus.face.refine import refined
from modiolus.fitting.register import Registration
from modiolus.mechanics import Continuation, Load, Settings, State
from modiolus.mechanics.face import Face, FaceSettings, face_problem
from modiolus.scans.align import place
from modiolus.scans.identify import Identification, _covariance, _noise, _Point, identify
from modiolus.scans.markers import Frame, bind, read_markers
from modiolus.scans.result import load_result
from modiolus.scans.scan import Scan
from modiolus.scans.sequence import follow, smoothed
from modiolus.scans.skin import Skin
from modiolus.scans.target import MarkerTarget, Matches, ScanTarget
from modiolus.scans.unknown import Driven, Unknown, muscle_set, unknowns

STILL = Registration()


def markers_on(skin, parameters):
    """Markers all over the skin, where a state has taken them."""
    rest = skin.head.tissue.parameters
    feet = skin.state(rest).feet(skin.surface(rest).vertices[::5])
    points = skin.places(feet, parameters)
    return MarkerTarget(skin, feet, points, np.zeros_like(points), known_pose=True)


# --- the unknowns


@pytest.mark.parametrize("sides", [False, True])
def test_slopes_of_all_unknowns_agree_with_finite_differences(block_head, sides):
    face = Face(block_head)
    head = block_head.whole if sides else block_head
    further = ("jaw",) if sides else ("jaw", "sigma_max", "fat", "passive", "skin")
    items = unknowns(head, None, (), further)
    driven = Driven(face, items)
    tight = Settings(tolerance=1e-11, passing=1e-6, augmentations=0)
    values = np.array([u.usual + (0.1 * u.scale if u.low == 0.0 else 0.0) for u in items])
    path = Continuation(driven.problem(values), settings=tight)
    path.run(driven.load(values))
    found = driven.slopes(path, values)
    for k, item in enumerate(items):
        ends = []
        for sign in (1.0, -1.0):
            there = values.copy()
            there[k] += sign * 1e-4 * item.scale
            trial = Continuation(driven.problem(there), path.state, settings=tight)
            ends.append(trial.run(driven.load(there)).parameters)
        slope = (ends[0] - ends[1]) / (2e-4 * item.scale)
        assert np.abs(slope).max() > 1e-3 / item.scale, item.name
        assert np.abs(slope - found[:, :, k]).max() < 1e-5 * np.abs(slope).max(), item.name


def test_other_tissue_is_that_of_a_problem_made_anew(block_head):
    settings = FaceSettings(fat=1.7, passive=0.6, skin=2.0, sigma_max=450.0)
    face = Face(block_head)
    made, driven = (
        face_problem(block_head, settings),
        Driven(face, unknowns(block_head, None, (), ("fat", "passive", "skin", "sigma_max"))),
    )
    values = [getattr(settings, u.name, 0.3) for u in driven.unknowns]
    varied = driven.problem(np.array(values))
    parameters = block_head.tissue.parameters * 1.01
    pressure = made.rest().pressure
    load = made.load({"strap": 0.3})
    one, other = (p.evaluate(parameters, pressure, load) for p in (made, varied))
    assert np.abs(one.residual - other.residual).max() < 1e-12 * np.abs(one.residual).max()
    assert one.energies == pytest.approx(other.energies, rel=1e-12)
    usual = face.half.evaluate(parameters, pressure, load)
    assert np.abs(one.residual - usual.residual).max() > 1e-2 * np.abs(one.residual).max()


def test_names_of_muscles_of_table_2_and_of_further_unknowns(taro, block_head):
    assert muscle_set(["frontalis", "mentalis"], taro) == [
        *("mentalis", "frontalis_medial", "frontalis_lateral"),
    ]
    # Six in the paper, of which the orbital part of orbicularis oculi is in two.
    smiling = muscle_set(["smile-closed"], taro)
    assert len(smiling) == 7 and "orbicularis_oculi_malar" in smiling
    assert muscle_set(["strap_left"], block_head.whole) == ["strap_left"]
    assert muscle_set(["strap"], block_head.whole) == ["strap_left", "strap_right"]
    with pytest.raises(InputError, match="zygomaticus_major"):
        muscle_set(["zygomaticus"], taro)
    with pytest.raises(InputError, match="sigma_max"):
        unknowns(taro, [], (), ["sigma"])
    with pytest.raises(InputError, match="there are none"):
        unknowns(taro, [])
    costs = {u.name: u.cost for u in unknowns(taro, None, ["frontalis"], ["jaw"])}
    assert costs["frontalis_medial"] < costs["mentalis"] and costs["jaw"] == 0.0


# --- the search


def test_activation_jaw_and_tissue_come_back_from_markers(block_head):
    face, skin = Face(block_head), Skin(block_head)
    items = unknowns(block_head, None, (), ("jaw", "fat"))
    true = np.array([0.4, np.radians(5.0), 1.6])
    driven = Driven(face, items)
    state = Continuation(driven.problem(true)).run(driven.load(true))
    target = markers_on(skin, state.parameters)
    found = identify(face, target, items)
    assert found.history[-1] < 1e-3 * found.history[0]
    assert found.values["strap"] == pytest.approx(0.4, abs=1e-3)
    assert found.values["jaw"] == pytest.approx(np.radians(5.0), rel=1e-3)
    assert found.values["fat"] == pytest.approx(1.6, rel=1e-2)
    assert found.activations == {"strap": found.values["strap"]}
    # From there, the same frame again costs next to nothing.
    again = identify(face, target, items, start=found)
    assert again.solves <= 2 and again.values["strap"] == pytest.approx(0.4, abs=0.01)


def test_sides_are_told_apart(block_head):
    face, skin = Face(block_head), Skin(block_head)
    state = face.solve({"strap_left": 0.5, "strap_right": 0.1})
    target = markers_on(skin, state.parameters)
    found = identify(face, target, unknowns(block_head.whole))
    assert found.values["strap_left"] == pytest.approx(0.5, abs=0.03)
    assert found.values["strap_right"] == pytest.approx(0.1, abs=0.03)


def test_smoothed_values_weigh_what_frames_tell_against_changes():
    rng = np.random.default_rng(1)
    items = [Unknown("a", -9.0, 9.0, 1.0), Unknown("b", 0.0, 9.0, 0.2)]
    times, values = np.array([0.0, 0.5, 0.6, 2.0]), rng.standard_normal((4, 2))
    root = rng.standard_normal((4, 2, 2))
    covariances = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)

    def cost(flat):
        q = flat.reshape(4, 2)
        apart = np.einsum("ti,tij,tj", q - values, np.linalg.inv(covariances), q - values)
        return (
            apart + 0.3 * ((np.diff(q, axis=0) / [1.0, 0.2]) ** 2 / np.diff(times)[:, None]).sum()
        )

    best = minimize(cost, values.ravel(), tol=1e-12).x.reshape(4, 2)
    found = smoothed(times, values, covariances, items, 0.3)
    assert found == pytest.approx(np.clip(best, [-9.0, 0.0], 9.0), abs=1e-5)
    # Nothing lags behind: backwards in time it is the same.
    back = smoothed(-times[::-1], values[::-1], covariances[::-1], items, 0.3)[::-1]
    assert back == pytest.approx(found, abs=1e-12)
    assert np.ptp(smoothed(times, values, covariances, items, 1e6)[:, 0]) < 1e-3
    assert np.array_equal(smoothed(times[:1], values[:1], covariances[:1], items, 0.3), values[:1])


def test_a_sequence_is_smoothed_and_frames_that_fail_are_told(block_head):
    face, skin = Face(block_head), Skin(block_head)
    items = unknowns(block_head)
    rng = np.random.default_rng(3)
    held = face.solve({"strap": 0.3}).parameters
    takes = []
    for number in range(4):
        target = markers_on(skin, held)
        target.points += 0.5 * rng.standard_normal(target.points.shape)
        takes.append(SimpleNamespace(time=0.1 * number, target=lambda target=target: target))

    def lost():
        raise InputError("frame 2: too few markers; give more")

    takes[1].target = lost
    alone, steady = (list(follow(face, takes, items, span)) for span in (0.0, 200.0))
    assert all(frame is take for (frame, _), take in zip(steady, takes, strict=True))
    assert "too few" in str(steady[1][1]) and "too few" in str(alone[1][1])
    met = [0, 2, 3]
    own, even = (np.array([found[k][1].values["strap"] for k in met]) for found in (alone, steady))
    assert np.ptp(even) < 0.5 * np.ptp(own)
    assert np.abs(even - 0.3).max() < np.abs(own - 0.3).max()
    # What is returned is the face at these values: its nodes, in mm.
    again = face.solve({"strap": even[2]}).parameters
    assert np.abs(again - steady[3][1].state.parameters)[::8].max() < 0.01


def objective(driven, target, unknown, path, values):
    """Energy of the whole objective at some values, from an equilibrium nearby."""
    trial = Continuation(driven.problem(values), path.state, settings=path.settings)
    state = trial.run(driven.load(values))
    point = _Point(values, STILL, state.parameters, target, unknown)
    return point.energy(1.0)


def test_the_gradient_of_the_objective_agrees_with_finite_differences(block_head):
    face, skin = Face(block_head), Skin(block_head)
    items = unknowns(block_head, None, (), ("jaw",))
    driven = Driven(face, items)
    target = markers_on(skin, face.solve({"strap": 0.6}).parameters)
    values = np.array([0.35, 0.03])
    path = Continuation(
        driven.problem(values), settings=Settings(tolerance=1e-12, passing=1e-6, augmentations=0)
    )
    path.run(driven.load(values))
    point = _Point(values, STILL, path.state.parameters, target, items)
    point.noise = 1.0
    slopes = point.matches.slopes(skin, driven.slopes(path, values))
    gradient = point.gradient(slopes)
    for k, item in enumerate(items):
        ends = []
        for factor in (2.0, 1.0, -1.0, -2.0):
            there = values.copy()
            there[k] += factor * 2e-4 * item.scale
            ends.append(objective(driven, target, items, path, there))
        # Of fourth order.
        slope = (8.0 * (ends[1] - ends[2]) - (ends[0] - ends[3])) / (12.0 * 2e-4)
        assert slope == pytest.approx(gradient[k], rel=1e-6), item.name


def test_the_gradient_of_the_distances_agrees_with_finite_differences(taro, skin):
    names = ["zygomaticus_major", "frontalis_lateral"]
    path = Continuation(face_problem(taro))
    change = path.sensitivities(names)
    rest = taro.tissue.parameters
    surface = skin.surface(rest)
    bump = 0.2 * np.sin(0.2 * surface.vertices[:, :1]) * surface.vertex_normals
    neutral = Scan.of(Surface(surface.vertices + bump, surface.faces, "neutral"))
    smile = skin.surface(rest + 0.1 * change[:, :, 0]).vertices
    target = ScanTarget(skin, Scan.of(Surface(smile + bump, surface.faces, "smile")), neutral)
    parameters = rest + 0.04 * change.sum(axis=2)
    target.renew(parameters, STILL)
    matches = target.matches(parameters, STILL)
    weight, residual = matches.weight, matches.residual
    slopes = matches.slopes(skin, change)[:, :2]
    step = 1e-6
    for k in range(2):
        ends = [
            target.matches(parameters + h * change[:, :, k], STILL).residual for h in (step, -step)
        ]
        assert len(ends[0]) == len(ends[1]) == len(residual)
        # Where the closest point jumps, as across a slit or at an edge of the scan, there is no
        # derivative.
        found = (ends[0] - ends[1]) / (2.0 * step)
        smooth = np.abs(ends[0] + ends[1] - 2.0 * residual) < 1e-9
        smooth &= np.abs(found - slopes[:, k]) < 1e-2
        assert smooth.mean() > 0.999
        gradient = 2.0 * (weight * residual * slopes[:, k])[smooth].sum()
        assert 2.0 * (weight * residual * found)[smooth].sum() == pytest.approx(gradient, rel=1e-6)
        assert abs(gradient) > 1e-3


def test_what_is_no_skin_at_rest_is_not_matched(taro, skin):
    rest = taro.tissue.parameters
    surface = skin.surface(rest)
    apart = np.linalg.norm(surface.vertices - taro.landmark_points()["cheek_left"], axis=1)
    hair = surface.vertices - 9.0 * np.exp(-((apart / 15.0) ** 8))[:, None] * [0.0, 1.0, 0.0]
    neutral = Scan.of(Surface(hair, surface.faces, "neutral"))
    far = []
    for known in (None, neutral):
        target = ScanTarget(skin, neutral, known)
        target.renew(rest, STILL)
        far.append(target.matches(rest, STILL).mean)
    assert far[1] < 0.2 * far[0]


@pytest.mark.parametrize("alike", [1, 10])
def test_the_covariance_is_that_of_least_squares(alike):
    """For noise of one, which ten points of a patch share or each has of its own."""
    rng = np.random.default_rng(5)
    patches = 400
    place = np.repeat(np.arange(patches), 10)
    n = len(place)
    points = 20.0 * np.stack([place % 20, place // 20, 0 * place], axis=1)
    points += rng.uniform(-5.0, 5.0, points.shape)
    slopes = rng.standard_normal((patches, 10))[place]
    slopes[:, 2] = slopes[:, 0] + 0.1 * rng.standard_normal(patches)[place]
    feet = type("Feet", (), {"points": points})()
    found = []
    for _ in range(20):
        noise = rng.standard_normal(n if alike == 1 else patches)
        noise = noise if alike == 1 else noise[place]
        # As at the end of a search.
        left = noise - slopes @ np.linalg.lstsq(slopes, noise, rcond=None)[0]
        point = _Point.__new__(_Point)
        point.matches = Matches(feet, np.zeros((n, 3)), left, points, np.full(n, 1.0 / n))
        point.mean, point.noise = point.matches.mean, _noise(point.matches)
        point.pose_cost, point.scales, point.units = 0.0, np.full(3, 0.5), np.ones(7)
        point.values = np.zeros(3)
        found.append(_covariance(slopes, point))
    true = alike * np.linalg.inv(slopes.T @ slopes)[:3, :3]
    assert np.mean(found, axis=0).ravel() == pytest.approx(true.ravel(), rel=0.1, abs=1e-4)

    items = tuple(Unknown(name, 0.0, 1.0, 1.0) for name in "abc")
    values = dict.fromkeys("abc", 0.5)
    told = Identification(items, values, found[0], None, None, STILL, (1.0,), 1)
    assert [set(pair[:2]) for pair in told.correlated] == [{"a", "c"}]
    assert told.correlated[0][2] < -0.98
    assert {"a", "c"} <= {*told.unsure}
    assert told.deviations["a"] > 5.0 * told.deviations["b"]


def test_scans_that_cannot_be_matched_are_refused(taro, skin, block_head):
    surface = skin.surface(taro.tissue.parameters)
    # A few triangles of the forehead, as seen from inside.
    corners = surface.vertices[surface.faces]
    high = (corners[:, :, 2] > surface.vertices[:, 2].max() - 20.0).all(axis=1)
    high &= (np.abs(corners[:, :, 0] - taro.midplane) < 10.0).all(axis=1)
    inward = Surface(surface.vertices, surface.faces[high][:, ::-1], "inward.ply")
    with pytest.raises(InputError, match=r"inward.ply: from the front none"):
        ScanTarget(skin, Scan.of(inward))
    away = Surface(surface.vertices - np.array([0.0, 100.0, 0.0]), surface.faces, "away.ply")
    with pytest.raises(SolveError, match=r"away.ply: it does not meet"):
        ScanTarget(skin, Scan.of(away)).matches(taro.tissue.parameters, STILL)
    finer = Skin(refined(block_head, (2, 2, 1)))
    with pytest.raises(InputError, match=r"block: its skin has 32 elements.*before it was refined"):
        _ = finer.region


# --- markers


def test_markers_are_read_frame_by_frame(tmp_path):
    path = tmp_path / "take.csv"
    path.write_text(
        "\ufeffframe, marker, x, y, z\n10, a, 1, 2, 3\n10, b, 4, 5, 6\n9, a, 7, 8, 9\n9, b, , ,\n"
        "8, a, nan, nan, nan\n"
    )
    frames = read_markers(path, rate=10.0)
    assert [frame.time for frame in frames] == [0.9, 1.0]
    assert list(frames[0].points) == ["a"] and frames[1].points["b"].tolist() == [4, 5, 6]
    for text, fault in [
        ("x,y,z\n1,2,3\n", "line 2 has no marker"),
        ("marker,x,y,z\na,1,2\n", "line 2 has no numbers"),
        ("time,marker,x,y,z\nsoon,a,1,2,3\n", "line 2 has a time"),
        ("marker,x,y,z\na,1,2,3\na,1,2,3\n", "a is there twice"),
        ("marker,x,y,z\n", "no markers"),
    ]:
        path.write_text(text)
        with pytest.raises(InputError, match=fault):
            read_markers(path)


def test_markers_are_bound_by_name_and_by_place_in_any_pose(taro, skin):
    rest = taro.tissue.parameters
    surface = skin.surface(rest)
    rng = np.random.default_rng(2)
    feet = skin.state(rest).feet(surface.vertices)
    zone = skin.zones(feet)
    still = [int(np.flatnonzero(zone == k)[40]) for k in range(4)]
    picked = [*still, *rng.choice(np.flatnonzero(zone < 0), 10, replace=False).tolist()]
    turn = Rotation.from_euler("xyz", [100.0, 20.0, -30.0], degrees=True).as_matrix()

    def measured(points, turn, shift):
        return 0.1 * (points @ turn.T) + shift

    known = {
        name: taro.landmark_points()[name] for name in ("chin", "ala_left", "inner_brow_right")
    }
    above = surface.vertices + 2.0 * surface.vertex_normals
    points = known | {f"m{k}": above[k] for k in picked} | {"cap": np.array([0.0, -80.0, 1700.0])}
    frame = Frame(0.0, {k: measured(p, turn, 5.0) for k, p in points.items()})
    marked = bind(skin, frame, frame, where="take.csv")
    assert marked.left_out == ["cap"] and len(marked.names) == len(points) - 1
    at = marked.names.index("chin")
    assert np.allclose(marked.feet.points[at], known["chin"])
    assert marked.pose.scale == pytest.approx(10.0, rel=1e-6)
    gap = np.linalg.norm(marked.rest - marked.feet.points, axis=1)
    assert np.allclose(gap[3:], 2.0, atol=0.05)

    # The head turns, the chin drops: only that is left when the still markers are in place.
    other = Rotation.from_euler("z", 25.0, degrees=True).as_matrix() @ turn
    dropped = points | {"chin": known["chin"] - [0.0, 0.0, 6.0]}
    target = marked.target(Frame(1.0, {k: measured(p, other, -3.0) for k, p in dropped.items()}))
    assert target.known_pose
    gaps = target.matches(rest, STILL).residual.reshape(-1, 3)
    assert np.allclose(gaps[at], [0.0, 0.0, -6.0], atol=1e-6)
    assert np.abs(np.delete(gaps, at, axis=0)).max() < 1e-6

    with pytest.raises(InputError, match="frame at 2 s: 1 markers"):
        marked.target(Frame(2.0, {"chin": np.zeros(3)}))
    few = Frame(0.0, {k: frame.points[k] for k in ("chin", "cap")})
    with pytest.raises(InputError, match=r"1 places of the head are known.*--landmarks"):
        bind(skin, few, few, where="take.csv")
    with pytest.raises(InputError, match=r"wrong unit, in m .*in cm"):
        bind(skin, frame, frame, unit="m")


# --- the command line


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return left.value.code, printed.out, printed.err


def take_of(skin, path, states, names):
    """Write landmarks and others of the skin in some states as markers, a frame each."""
    labels, known = skin.landmarks()
    rest = skin.head.tissue.parameters
    other = skin.state(rest).feet(skin.surface(rest).vertices[3::200])
    rows = ["frame,marker,x_mm,y_mm,z_mm"]
    for number, parameters in enumerate(states):
        points = [*skin.places(known, parameters), *skin.places(other, parameters)]
        for name, point in zip([*labels, *(f"m{k}" for k in range(200))], points, strict=False):
            if name in names or name.startswith("m"):
                rows.append(f"{number},{name},{','.join(map(str, point))}")
    path.write_text("\n".join(rows) + "\n")


def test_a_sequence_becomes_a_table_expressions_and_an_animation(
    capsys, monkeypatch, taro, skin, tmp_path
):
    rest = taro.tissue.parameters
    moved = [rest.copy() for _ in range(3)]
    for number, parameters in enumerate(moved):
        parameters[:, 1] -= number * taro.both.ones
    take_of(skin, tmp_path / "take.csv", moved, ["chin", "ala_left", "ala_right"])
    starts = []

    def found(face, target, items, *, start=None, report=None):
        report(1.0, "done")
        starts.append(start)
        number = len(starts) - 1
        values = {u.name: 0.25 * number * u.scale for u in items}
        if number == 1:
            raise SolveError("the second frame: not met")
        load = Driven(face, items).load(np.array(list(values.values())))
        state = State(taro.tissue, moved[number], np.zeros(0), np.zeros((252, 0), int), load)
        unsure = np.diag([0.1 * (u.name == "mentalis") + 0.001 for u in items]) ** 2
        return Identification(tuple(items), values, unsure, state, state, STILL, (1.0, 0.5), 2)

    monkeypatch.setattr("modiolus.scans.sequence.identify", found)
    monkeypatch.setattr(Face, "half", property(lambda face: None))
    monkeypatch.setattr(
        "modiolus.scans.unknown.face_load",
        lambda problem, head, activations, jaw: Load(activations, None, jaw),
    )
    out = tmp_path / "out"
    code, printed, error = run(
        capsys,
        *("identify", "--markers", tmp_path / "take.csv", "--rate", "10", "--unknown", "jaw"),
        *("--muscles", "mentalis,zygomaticus_major", "--out", out, "--json"),
    )
    assert code == 0, error
    record = json.loads(printed)
    assert [row["frame"] for row in record["frames"]] == ["take-1", "take-2", "take-3"]
    assert record["frames"][1]["fault"].startswith("the second") and not record["left_out"]
    # The third frame begins where the first one has come to.
    assert starts[0] is None and starts[1] is starts[2] is not None
    folder = out / "identify-take"
    with (folder / "activations.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["time"] for row in rows] == ["0.0", "0.2"]
    assert rows[1]["mentalis"] == "0.1" and float(rows[1]["jaw_open"]) == pytest.approx(5.0)
    expression = Expression.read(folder / "frames" / "take-3" / "take-3.toml")
    assert expression.activations == {"mentalis": 0.1, "zygomaticus_major": 0.5}
    assert expression.jaw_open == pytest.approx(5.0, abs=1e-4)

    frames = sorted((folder / "frames").iterdir())
    assert load_result(frames[1]).time == pytest.approx(0.2)
    code, printed, error = run(capsys, "export", *frames, "--glb", out / "faces", "--json")
    assert code == 0, error
    assert json.loads(printed)["seconds"] == pytest.approx(0.2)
    model = pygltflib.GLTF2().load_binary(str(out / "faces" / "faces.glb"))
    assert model.animations and model.meshes[0].extras["targetNames"] == ["take-1", "take-3"]


@pytest.mark.slow
def test_the_gradient_on_the_face_agrees_with_finite_differences(taro, skin):
    face = Face(taro)
    items = unknowns(taro, ["zygomaticus_major", "orbicularis_oris"], (), ["jaw"])
    driven = Driven(face, items)
    target = markers_on(skin, face.solve({"zygomaticus_major": 0.5, "mentalis": 0.1}).parameters)
    values = np.array([0.4, 0.03, 0.03, 0.05])
    tight = Settings(tolerance=1e-10, passing=1e-3, augmentations=0, first_step=0.3)
    path = Continuation(driven.problem(values), settings=tight)
    path.run(driven.load(values))
    point = _Point(values, STILL, path.state.parameters, target, items)
    point.noise = 1.0
    gradient = point.gradient(point.matches.slopes(skin, driven.slopes(path, values)))
    step = 1e-5
    for k in (0, 2, 3):
        there = [values + sign * step * np.eye(4)[k] * items[k].scale for sign in (1.0, -1.0)]
        ends = [objective(driven, target, items, path, at) for at in there]
        assert (ends[0] - ends[1]) / (2.0 * step) == pytest.approx(gradient[k], rel=1e-6)


@pytest.mark.slow
def test_markers_of_a_smile_are_followed(capsys, taro, skin, tmp_path):
    face = Face(taro)
    states = [face.half.rest().parameters]
    for value in (0.2, 0.4):
        states.append(face.solve({"zygomaticus_major": value, "mentalis": 0.2}).parameters)
    take_of(skin, tmp_path / "take.csv", states, ["chin", "ala_left", "ala_right"])
    code, printed, error = run(
        capsys,
        *("identify", "--markers", tmp_path / "take.csv", "--out", tmp_path / "out", "--json"),
        *("--muscles", "mentalis,zygomaticus_major,risorius"),
    )
    assert code == 0, error
    for row, value in zip(json.loads(printed)["frames"], (0.0, 0.2, 0.4), strict=True):
        assert row["activations"]["zygomaticus_major"] == pytest.approx(value, abs=0.03)
        assert row["activations"]["mentalis"] == pytest.approx(0.2 * (value > 0.0), abs=0.03)
        assert row["activations"]["risorius"] < 0.03


@pytest.mark.slow
def test_activations_come_back_from_a_noisy_scan_in_any_pose(taro, skin):
    rng = np.random.default_rng(0)
    true = {
        "zygomaticus_major": 0.64,
        "zygomaticus_minor": 0.27,
        "levator_anguli_oris": 0.01,
        "depressor_anguli_oris": 0.0,
        "depressor_labii_inferioris": 0.16,
        "mentalis": 0.18,
    }
    face = Face(taro)
    surface = skin.surface(face.solve(true).parameters)
    noise = 0.3 * rng.standard_normal((len(surface.vertices), 1)) * surface.vertex_normals
    turn = Rotation.random(rng=rng).as_matrix()
    moved = Surface((surface.vertices + noise) @ turn.T + 100.0, surface.faces, "smile")
    placed, _, _ = place(Scan.of(moved), skin)
    found = identify(face, ScanTarget(skin, placed), unknowns(taro, list(true)))
    for name, value in true.items():
        assert abs(found.activations[name] - value) < 0.03 or name in found.unsure
    assert found.history[-1] < 0.35 < found.history[0]
