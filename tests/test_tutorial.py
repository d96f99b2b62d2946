"""The tutorial: its commands, as they stand in the documentation, on the image that it names."""

import importlib.util
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from modiolus.cli import _run

TUTORIAL = Path(__file__).parents[1] / "docs" / "tutorial.md"


def commands() -> list[list[str]]:
    """The commands of the tutorial: what its block of the kind ``console`` has."""
    block = TUTORIAL.read_text(encoding="utf-8").split("```console\n")[1].split("```")[0]
    return [line.split()[1:] for line in block.splitlines()]


def mean_head() -> Path | None:
    """The mean T1 image that pydeface ships; only its data are used."""
    found = importlib.util.find_spec("pydeface")
    if found is None or not found.submodule_search_locations:
        return None
    return Path(found.submodule_search_locations[0]) / "data" / "mean_reg2mean.nii.gz"


def test_the_tutorial_has_three_commands() -> None:
    assert [command[0] for command in commands()] == ["segment", "morph", "simulate"]


@pytest.mark.slow
@pytest.mark.skipif(mean_head() is None, reason="pydeface is not installed; make tutorial does")
def test_three_commands_from_an_image_to_a_smile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = mean_head()
    assert image is not None
    shutil.copy(image, tmp_path)
    monkeypatch.chdir(tmp_path)
    for command in commands():
        assert _run(command) == 0, command
        sys.stderr.flush()
    segmented = json.loads(Path("mean/report.json").read_text())
    assert set(segmented["face"]["missing"]) == {"chin", "neck"}
    morphed = json.loads(Path("heads/mean/report.json").read_text())
    assert all(gate["passed"] for gate in morphed["gates"]), morphed["gates"]
    quality = morphed["quality"]
    assert quality["scan_rms_mm"] <= 0.5
    assert quality["lip_margins_rms_mm"] <= 0.5
    # The image shows no margins of lids.
    assert "lid_margins_rms_mm" not in quality
    smile = json.loads(Path("out/smile-closed/report.json").read_text())
    assert smile["converged"]
    assert smile["max_penetration_mm"] < 0.1
    corner = np.array(smile["landmarks"]["mouth_corner_left"]["displacement"])
    # Aside, back and up, by as much as corners do that smile.
    assert (corner > 1.0).all()
    assert 4.0 < np.linalg.norm(corner) < 14.0
    assert Path("out/smile-closed/face.png").stat().st_size > 0
