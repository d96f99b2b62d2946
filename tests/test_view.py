"""The software renderer and the figures."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from modiolus.errors import InputError
from modiolus.export import Shape, vertex_normals
from modiolus.export.scene import eye
from modiolus.view import Camera, Curves, Panel, Scale, draw, figure
from modiolus.view.face import face_panels
from modiolus.view.raster import BACKGROUND

CAMERA = Camera((0.0, 0.0, 0.0), height=40.0)


def ball(centre=(0.0, 0.0, 0.0), radius=10.0, colour=(0.8, 0.2, 0.2)):
    shape = eye(np.array(centre), radius, "ball")
    return Shape(shape.vertices, shape.faces, colour, gloss=0.0)


def background(pixel):
    return np.allclose(pixel, BACKGROUND, atol=1e-6)


def test_camera_axes_are_a_right_handed_frame():
    for azimuth, elevation in ((0.0, 0.0), (38.0, 4.0), (-90.0, 60.0)):
        axes = Camera((0.0, 0.0, 0.0), 1.0, azimuth, elevation).axes()
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(axes) == pytest.approx(1.0)


def test_front_view_has_the_subjects_left_on_the_right():
    # The face looks to -y; who looks at it sees its left side (+x) on the right, +z on top.
    column, row, _ = CAMERA.project(np.array([[5.0, 0.0, 10.0]]), 80, 80)[0]
    assert column > 40.0
    assert row < 40.0


def test_a_ball_covers_its_disc():
    picture = draw([ball()], [], CAMERA, 80, 80)
    covered = np.abs(picture - BACKGROUND).max(axis=2) > 0.02
    # A disc of radius 10 in a picture 40 mm and 80 pixels high.
    assert covered.sum() == pytest.approx(np.pi * 20.0**2, rel=0.04)
    assert background(picture[0, 0]) and not background(picture[40, 40])


def test_what_is_nearer_hides_what_is_behind():
    red, green = ball((0.0, -15.0, 0.0), 5.0, (1.0, 0.0, 0.0)), ball(colour=(0.0, 1.0, 0.0))
    for shapes in ([red, green], [green, red]):
        middle = draw(shapes, [], CAMERA, 80, 80)[40, 40]
        assert middle[0] > 0.3 and middle[1] < 0.2


def test_surfaces_hide_lines_behind_them():
    line = np.array([[-15.0, 20.0, 0.0], [15.0, 20.0, 0.0]])
    curves = Curves(line, np.array([2]), (0.0, 0.0, 1.0), width=3.0)
    picture = draw([ball()], [curves], CAMERA, 80, 80)
    assert picture[40, 40, 0] > picture[40, 40, 2]
    np.testing.assert_allclose(picture[40, 12], [0.0, 0.0, 1.0], atol=0.02)


def test_what_is_behind_the_camera_is_not_drawn():
    near = Camera((0.0, 0.0, 0.0), height=40.0, distance=50.0)
    assert background(draw([ball((0.0, -70.0, 0.0))], [], near, 20, 20))


def test_drawing_is_repeatable():
    np.testing.assert_array_equal(
        draw([ball()], [], CAMERA, 60, 60), draw([ball()], [], CAMERA, 60, 60)
    )


def test_nothing_to_draw_is_background():
    assert background(draw([], [], CAMERA, 20, 20))


def test_vertex_normals_of_a_ball_point_outwards():
    shape = ball()
    normals = vertex_normals(shape.vertices, shape.faces)
    np.testing.assert_allclose(normals, shape.vertices / 10.0, atol=0.05)


def test_scale_takes_the_colours_of_its_ends_beyond_them():
    colours = Scale("mm", 0.0, 2.0).colours(np.array([-1.0, 0.0, 2.0, 5.0]))
    np.testing.assert_array_equal(colours[0], colours[1])
    np.testing.assert_array_equal(colours[2], colours[3])
    assert (colours[0] > colours[2]).all()


def test_figure_writes_a_png(tmp_path):
    panels = [Panel(CAMERA, [ball()], title="ball", scale=Scale("mm", 0.0, 1.0))] * 3
    figure(panels, tmp_path / "page.png", columns=2, panel_size=(120, 100), heading="Balls")
    with Image.open(tmp_path / "page.png") as page:
        assert page.format == "PNG"
        assert page.width == 240 and page.height > 200


def test_pictures_and_files_need_no_opengl(tmp_path):
    """Neither a picture nor a VTU file nor a level surface loads the system's OpenGL or X."""
    code = """
import numpy as np
from pathlib import Path
from modiolus.anatomy import DistanceGrid, Surface
from modiolus.export import write_vtu
from modiolus.export.scene import eye
from modiolus.view import Camera, Panel, figure

ball = eye(np.zeros(3), 10.0, "ball")
figure([Panel(Camera((0, 0, 0), 40.0), [ball])], Path("ball.png"), 1, (40, 40))
cube = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)
write_vtu(Path("cube.vtu"), cube, np.arange(8)[None], {"J": np.ones(8)})
DistanceGrid.of([Surface(ball.vertices, ball.faces)], 1.0).surface()
print(Path("/proc/self/maps").read_text())
"""
    environment = {"PATH": "/usr/bin:/bin"}
    answer = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    assert not re.search(r"/lib(GL|GLX|EGL|OSMesa|X11)[.-]", answer.stdout)
    assert (tmp_path / "ball.png").stat().st_size > 0
    assert (tmp_path / "cube.vtu").stat().st_size > 0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: Shape(np.zeros((2, 3)), np.array([[0, 1, 2]]), (1.0, 1.0, 1.0), "skin"),
            "skin: f",
        ),
        (lambda: Shape(np.zeros((3, 2)), np.array([[0, 1, 2]]), (1.0, 1.0, 1.0)), "vertices"),
        (lambda: Shape(np.full((3, 3), np.nan), np.array([[0, 1, 2]]), (1.0, 1.0, 1.0)), "NaN"),
        (lambda: Shape(np.zeros((3, 3)), np.array([[0, 1]]), (1.0, 1.0, 1.0)), "three corners"),
        (lambda: Shape(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros((2, 3))), "colour"),
        (lambda: Scale("mm", 1.0, 1.0), "scale: 1 to 1"),
        (lambda: Scale("mm", 0.0, np.nan), "scale: 0 to nan"),
        (lambda: Camera((0.0, 0.0, 0.0), 0.0), "camera: height 0"),
        (lambda: Camera((0.0, np.nan, 0.0), 1.0), "camera: target"),
        (lambda: Curves(np.zeros((3, 3)), np.array([2]), (0.0, 0.0, 1.0)), "3 points"),
        (lambda: Curves(np.zeros((3, 3)), np.array([3, 0]), (0.0, 0.0, 1.0)), "3 points"),
        (lambda: figure([], Path("page.png"), 1), "panels: 0"),
        (lambda: figure([Panel(CAMERA)], Path("page.png"), 0), "0 columns"),
    ],
)
def test_what_cannot_be_drawn_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_looks_stand_beside_each_other_in_every_view():
    class Ball:
        def skin_points(self, parameters):
            return ball().vertices

    scale = Scale("mm", 0.0, 1.0)
    looks = [("plain", [ball()], None), ("painted", [ball()], scale)]
    front, side = face_panels(Ball(), [np.zeros((1, 3))], looks, zoom=2.0)
    assert [panel.title for panel in front] == ["plain, front", "painted, front"]
    assert [panel.scale for panel in [*front, *side]] == [None, None, None, scale]
    assert front[0].camera.azimuth == 0.0 and side[0].camera.azimuth > 0.0
    # A ball of 20 mm, with a margin, at twice the size.
    assert front[0].camera.height == pytest.approx(10.8, rel=0.01)
