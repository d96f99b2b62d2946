"""Draw the pictures of the README and the documentation into docs/images (some minutes)."""

from pathlib import Path

from modiolus.cli.run import Runner
from modiolus.face.expression import Expression, resolve
from modiolus.face.head import Head
from modiolus.view.face import VIEWS, face_camera
from modiolus.view.figure import Panel, figure
from modiolus.view.muscles import draw_muscles

IMAGES = Path(__file__).parent / "images"


def draw_expressions(head: Head, names: list[str]) -> None:
    """Draw the face at rest and in expressions, from the front and from the side."""
    runner = Runner(head)
    rest = head.tissue.parameters
    states = [("at rest", rest)]
    for name in names:
        expression = Expression.shipped(name)
        state = runner.solve(name, resolve(expression.activations, head.muscles))
        states.append((expression.title, state.parameters))
    panels = [
        Panel(
            face_camera(runner.scene, rest, view),
            runner.scene.shapes(moved),
            title=title if view == "front" else "",
        )
        for view in VIEWS
        for title, moved in states
    ]
    figure(panels, IMAGES / "expressions.png", columns=len(states), panel_size=(360, 420))


if __name__ == "__main__":
    taro = Head.load("taro")
    IMAGES.mkdir(exist_ok=True)
    draw_muscles(taro, "Muscles of the left side · taro", IMAGES / "muscles.png")
    draw_expressions(taro, ["smile-closed", "smile-open", "sad", "terror"])
