"""Draw the pictures of the README and the documentation into docs/images (some minutes)."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from modiolus.cli.run import Runner
from modiolus.export.scene import FaceScene
from modiolus.face.expression import Expression, resolve
from modiolus.face.head import Head
from modiolus.face.jaw import opening
from modiolus.view.face import VIEWS, face_camera
from modiolus.view.figure import Panel, figure
from modiolus.view.muscles import draw_muscles

IMAGES = Path(__file__).parent / "images"


def _draw_states(scene: FaceScene, states: list[tuple[str, np.ndarray, float]], path: Path) -> None:
    """Draw states (title, parameters, jaw) beside each other, from the front and the side."""
    shown = [moved for _, moved, _ in states]
    panels = [
        Panel(
            face_camera(scene, shown, view),
            scene.shapes(moved, jaw=jaw),
            title=title if view == "front" else "",
        )
        for view in VIEWS
        for title, moved, jaw in states
    ]
    figure(panels, path, columns=len(states), panel_size=(360, 420))


def draw_expressions(head: Head, names: list[str]) -> None:
    """Draw the face at rest and in expressions, from the front and from the side."""
    runner = Runner(head)
    states = [("at rest", head.tissue.parameters, 0.0)]
    for name in names:
        expression = Expression.shipped(name)
        activations = resolve(expression.activations, head.muscles)
        state = runner.solve(name, activations, opening(expression.jaw_open))
        states.append((expression.title, state.parameters, state.load.jaw))
    _draw_states(runner.scene, states, IMAGES / "expressions.png")


def draw_sides_and_jaw(head: Head) -> None:
    """Draw faces that differ left and right, and faces with the jaw open."""
    runner = Runner(head)
    states = []
    for name, title, palsy, degrees in (
        ("wink", "Wink", "", 0.0),
        ("smirk", "Smirk", "", 0.0),
        ("smile-closed", "Smile, right side palsied", "right", 0.0),
        ("smile-open", "Smile, jaw open by 8°", "", 8.0),
        ("terror", "Terror, jaw open by 12°", "", 12.0),
    ):
        activations = resolve(Expression.shipped(name).activations, head.muscles, palsy)
        state = runner.solve(name, activations, opening(degrees))
        states.append((title, state.parameters, state.load.jaw))
    _draw_states(runner.scene, states, IMAGES / "sides-and-jaw.png")


def draw_layout(head: Head) -> None:
    """Draw where the skin lies in a texture, with its colours and every fourth line of its grid."""
    size = 900
    coarse, fine = FaceScene(head, divisions=2), FaceScene(head, divisions=8)
    image = Image.new("RGB", (size, size), "white")
    draw = ImageDraw.Draw(image)
    assert coarse.layout is not None and fine.layout is not None
    for scene, line in ((fine, False), (coarse, True)):
        places = scene.layout * [size, -size] + [0, size]
        for face in scene.skin_mirror.faces:
            corners = [tuple(place) for place in places[face]]
            colour = tuple(int(255 * value) for value in scene.colours[face].mean(axis=0))
            if line:
                draw.line([*corners[:2], corners[2]], fill=(120, 105, 100))
            else:
                draw.polygon(corners, fill=colour)
    image.save(IMAGES / "layout.png", optimize=True)


if __name__ == "__main__":
    taro = Head.load("taro")
    IMAGES.mkdir(exist_ok=True)
    draw_layout(taro)
    draw_muscles(taro, "Muscles of the left side · taro", IMAGES / "muscles.png")
    draw_expressions(taro, ["smile-closed", "smile-open", "sad", "terror"])
    draw_sides_and_jaw(taro)
