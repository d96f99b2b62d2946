"""BodyParts3D's head as named structures.

The folder holds one surface file for each part, named by its identifier in the Foundational Model
of Anatomy (FMA), and a manifest with the counts by which each file is checked. BodyParts3D,
© The Database Center for Life Science, is licensed under CC Attribution-Share Alike 2.1 Japan
(N. Mitsuhashi et al., Nucleic Acids Res. 37 (2009) D782). The parts themselves are not shipped.

Structures are those of the left side and of the mid-plane. Two names of the source are put
right here: what it calls the palpebral part of orbicularis oculi is the large outer ring, and
the reverse.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modiolus.anatomy.surface import MIDPLANE, Surface, read_surface
from modiolus.errors import InputError, unknown_name

__all__ = ["DEEP_STRUCTURES", "STRUCTURES", "BodyParts3D"]


@dataclass(frozen=True)
class _Part:
    """Where a structure is found: file, and what is done with its surface."""

    file: str
    left_only: bool = False
    """Keep the shells whose centre lies on the left of the mid-plane."""
    whole: bool = True
    """Keep all shells; otherwise only the largest, the rest being stray fragments."""


def _parts(prefix: str, ids: dict[str, str], **options: bool) -> dict[str, _Part]:
    return {prefix + name: _Part(f"FMA{fma}", **options) for name, fma in ids.items()}


_MUSCLES = _parts(
    "",
    {
        "zygomaticus_major": "46813",
        "zygomaticus_minor": "46815",
        "levator_labii_superioris": "46807",
        "levator_labii_superioris_alaeque_nasi": "46804",
        "levator_anguli_oris": "46824",
        "risorius": "46840",
        "buccinator": "46836",
        "depressor_anguli_oris": "46830",
        "depressor_labii_inferioris": "46818",
        "mentalis": "46827",
        "platysma": "45740",
        "orbicularis_oris": "46841",
        "orbicularis_oculi_orbital": "46786",
        "orbicularis_oculi_palpebral": "46783",
        "frontalis": "46760",
        "corrugator_supercilii": "46797",
        "procerus": "55611",
        "nasalis": "55607",
        "depressor_septi_nasi": "55609",
        "masseter_superficial": "49002",
        "masseter_deep": "49005",
    },
    whole=False,
)

_BONES = _parts(
    "",
    {
        "frontal_bone": "52734",
        "occipital_bone": "52735",
        "sphenoid": "52736",
        "ethmoid": "52740",
        "vomer": "9710",
        "temporal_bone": "52739",
        "parietal_bone": "52789",
        "zygomatic_bone": "52893",
        "lacrimal_bone": "53646",
        "nasal_bone": "53648",
        "maxilla": "53650",
        "palatine_bone": "53656",
        "inferior_concha": "54738",
        "nasal_bone_right": "53647",
        "maxilla_right": "53649",
        "parietal_bone_right": "52788",
        "mandible": "52748",
        "hyoid": "52749",
    },
)

_TEETH_UPPER = _parts(
    "tooth_upper_",
    {
        "central_incisor_right": "55681",
        "central_incisor": "55682",
        "lateral_incisor": "55683",
        "canine": "55799",
        "first_premolar": "55690",
        "second_premolar": "55691",
        "first_molar": "55699",
        "second_molar": "55700",
    },
)

_TEETH_LOWER = _parts(
    "tooth_lower_",
    {
        "central_incisor_right": "57142",
        "central_incisor": "57143",
        "lateral_incisor": "57141",
        "canine": "55687",
        "first_premolar": "55693",
        "second_premolar": "55692",
        "first_molar": "55704",
        "second_molar": "55703",
    },
)

#: Every structure that can be asked for, with where it is found.
STRUCTURES: dict[str, _Part] = {
    **_MUSCLES,
    **_BONES,
    **_TEETH_UPPER,
    **_TEETH_LOWER,
    "gingiva_upper": _Part("FMA59763"),
    "gingiva_lower": _Part("FMA59764"),
    "eyeball": _Part("FMA12513", left_only=True),
    "nasal_cartilages": _Part("FMA71704"),
    "eyebrow": _Part("FMA71098", left_only=True),
    "ear": _Part("FMA52780", left_only=True),
    "lips": _Part("FMA59815nsn"),
    "skin": _Part("skin"),
}

#: Deep structures, on which the tissue slides, with the structures that make them up. Those of
#: the right side that come near the mid-plane are among them.
DEEP_STRUCTURES: dict[str, tuple[str, ...]] = {
    "skull": tuple(name for name in _BONES if name not in ("mandible", "hyoid")),
    "mandible": ("mandible",),
    "teeth_upper": tuple(_TEETH_UPPER),
    "teeth_lower": tuple(_TEETH_LOWER),
    "gums_upper": ("gingiva_upper",),
    "gums_lower": ("gingiva_lower",),
    "masseter": ("masseter_superficial", "masseter_deep"),
    "eyeball": ("eyeball",),
    "cartilage": ("nasal_cartilages",),
}


class BodyParts3D:
    """The head of BodyParts3D, read from its folder part by part.

    Parameters
    ----------
    folder : path
        The folder with ``manifest.csv``, ``skin.ply`` and ``parts/``.

    Raises
    ------
    InputError
        The folder or its manifest is missing, or parts are: the message names the first missing
        file and its structure. Everything is looked for at once, before long work begins.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: no such folder; give the BodyParts3D folder")
        self._counts = self._manifest()
        missing = [name for name in STRUCTURES if not self.path(name).is_file()]
        if missing:
            more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
            raise InputError(
                f"{self.path(missing[0])}: missing, the part for {missing[0]}{more}; "
                "fetch it from BodyParts3D"
            )

    def _manifest(self) -> dict[str, tuple[int, int]]:
        path = self.folder / "manifest.csv"
        if not path.is_file():
            raise InputError(f"{path}: no such file; give the BodyParts3D folder")
        try:
            with path.open(newline="", encoding="utf-8") as file:
                return {
                    row["fma_id"]: (int(row["n_vertices"]), int(row["n_faces"]))
                    for row in csv.DictReader(file)
                }
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: cannot be read as a manifest; fetch it again") from error

    def path(self, name: str) -> Path:
        """Return the file of a structure.

        Raises
        ------
        InputError
            There is no structure of that name.
        """
        if name not in STRUCTURES:
            raise unknown_name("structure", name, STRUCTURES)
        file = STRUCTURES[name].file
        return self.folder / ("skin.ply" if file == "skin" else f"parts/{file}.ply")

    def surface(self, name: str) -> Surface:
        """Read one structure: its left side, or all of it when it crosses the mid-plane.

        Parameters
        ----------
        name : str
            A name in `STRUCTURES`.

        Raises
        ------
        InputError
            There is no such structure, or its file does not agree with the manifest.
        """
        path = self.path(name)
        surface = read_surface(path, name)
        part = STRUCTURES[name]
        counts = self._counts.get(part.file)
        if counts is not None and counts != (len(surface.vertices), len(surface.faces)):
            raise InputError(
                f"{path}: {name} with {len(surface.vertices)} vertices and {len(surface.faces)} "
                f"triangles, the manifest says {counts[0]} and {counts[1]}; fetch it again"
            )
        if not part.whole:
            surface = surface.largest_component()
        if part.left_only:
            shells = surface.components()
            kept = [shell for shell in shells if np.mean(shell.bounds[:, 0]) > MIDPLANE]
            surface = Surface.joined(kept, name)
        return surface

    def group(self, name: str) -> list[Surface]:
        """Read the surfaces of one of the `DEEP_STRUCTURES`.

        Raises
        ------
        InputError
            There is no such group, or a file is not sound.
        """
        if name not in DEEP_STRUCTURES:
            raise unknown_name("deep structure", name, DEEP_STRUCTURES)
        return [self.surface(part) for part in DEEP_STRUCTURES[name]]
