"""Expressions: which muscles contract and how much, and how far the jaw is open."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path

from ..errors import InputError, unknown_name
from ..files import folder_name, read_toml
from .jaw import WIDEST

__all__ = ["GROUPS", "Expression", "expression_names", "resolve"]

#: Muscles that are driven in parts, under the name of the whole.
GROUPS: dict[str, tuple[str, ...]] = {
    "frontalis": ("frontalis_medial", "frontalis_lateral"),
    "orbicularis_oculi": (
        "orbicularis_oculi_orbital",
        "orbicularis_oculi_palpebral",
        "orbicularis_oculi_malar",
    ),
    "orbicularis_oris": ("orbicularis_oris_upper", "orbicularis_oris_lower"),
}

_SIDES = ("left", "right")
_SHIPPED = files("modiolus.face") / "data" / "expressions"
_KNOWN_KEYS = ("title", "source", "jaw_open", "activations")


@dataclass(frozen=True)
class Expression:
    """A named set of activations, and how far the jaw is open.

    Parameters
    ----------
    name : str
        Such as ``"smile-closed"``.
    activations : mapping of str to float
        0..1, by the name of a muscle or of a group of `GROUPS`, with ``_left`` or ``_right`` for
        one side and without for both.
    title : str
        The expression in words.
    source : str
        Where the set of muscles comes from.
    jaw_open : float
        Angle of the jaw in degrees.
    """

    name: str
    activations: Mapping[str, float] = field(default_factory=dict)
    title: str = ""
    source: str = ""
    jaw_open: float = 0.0

    @classmethod
    def read(cls, path: str | Path) -> Expression:
        """Read an expression from a TOML file, whose stem becomes its name.

        The file has a table ``activations`` or ``jaw_open``, and may have ``title`` and ``source``.

        Raises
        ------
        InputError
            If the file cannot be read or says something that is not understood.
        """
        path = Path(path)
        return cls._checked(folder_name(str(path), path.stem), read_toml(path), str(path))

    @classmethod
    def shipped(cls, name: str) -> Expression:
        """Return one of the expressions that come with the package.

        Raises
        ------
        InputError
            If there is none of that name; the message has the nearest ones.
        """
        if name not in expression_names():
            raise unknown_name("expression", name, expression_names())
        text = (_SHIPPED / f"{name}.toml").read_text(encoding="utf-8")
        return cls._checked(name, tomllib.loads(text), f"{name}.toml")

    @classmethod
    def named(cls, name: str) -> Expression:
        """Return a shipped expression by its name, or read the TOML file of that name.

        Raises
        ------
        InputError
            There is no such expression, or the file cannot be used.
        """
        if name.lower().endswith(".toml"):
            return cls.read(name)
        if name not in expression_names() and Path(name).is_file():
            raise InputError(f"{name}: not called a TOML file; end its name in .toml")
        return cls.shipped(name)

    @classmethod
    def _checked(cls, name: str, content: Mapping[str, object], where: str) -> Expression:
        for key in content:
            if key not in _KNOWN_KEYS:
                raise InputError(f"{where}: {unknown_name('key', key, _KNOWN_KEYS)}")
        jaw = _number(content.get("jaw_open", 0.0), f"{where}: jaw_open", WIDEST)
        table = content.get("activations", {})
        if not isinstance(table, dict) or not (table or jaw):
            raise InputError(
                f"{where}: it has no activations; add a table [activations] with muscle = value"
            )
        activations = {
            muscle: _number(value, f"{where}: activation of {muscle}", 1.0)
            for muscle, value in table.items()
        }
        title, source = (content.get(key, "") for key in ("title", "source"))
        if not isinstance(title, str) or not isinstance(source, str):
            raise InputError(f"{where}: title or source is no text; put it in quotes")
        return cls(name, activations, title, source, jaw)


def _number(value: object, what: str, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= most:
        raise InputError(f"{what} is {value!r}; give a number within 0 to {most:g}")
    return float(value)


def expression_names() -> tuple[str, ...]:
    """Return the names of the expressions that come with the package."""
    return tuple(
        sorted(
            entry.name.removesuffix(".toml")
            for entry in _SHIPPED.iterdir()
            if entry.name.endswith(".toml")
        )
    )


def resolve(
    activations: Mapping[str, float], muscles: Iterable[str], palsy: str = ""
) -> dict[str, float]:
    """Return the activation of each muscle of a head.

    Parameters
    ----------
    activations : mapping of str to float
        As in `Expression`; what is said of a part counts more than what is said of its group,
        what is said of a side more than what is said of both.
    muscles : iterable of str
        The muscles of the head, without a side.
    palsy : {'', 'left', 'right'}
        The side on which all muscles rest, as in palsy of the facial nerve.

    Returns
    -------
    dict of str to float
        By muscle; those at rest are left out. Where the two sides agree the names have no side
        and the half of the head will do; otherwise all of them have one.

    Raises
    ------
    InputError
        If a muscle or side is not known, or an activation is not within 0 to 1.
    """
    if palsy and palsy not in _SIDES:
        raise unknown_name("palsied side", palsy, _SIDES)
    muscles = tuple(muscles)
    parts = {
        group: tuple(part for part in members if part in muscles)
        for group, members in GROUPS.items()
    }
    known = {group: members for group, members in parts.items() if members}
    known.update({muscle: (muscle,) for muscle in muscles})
    wanted: list[tuple[int, str, str, float]] = []
    for name, value in activations.items():
        if not 0.0 <= value <= 1.0:
            raise InputError(f"{name}: activation {value:g} is not within 0 to 1; mend it")
        stem, _, end = name.rpartition("_")
        sides = (end,) if end in _SIDES and stem in known else _SIDES
        whole = stem if len(sides) == 1 else name
        if whole not in known:
            raise unknown_name("muscle", name, known)
        rank = 2 * (whole in muscles) + (len(sides) == 1)
        wanted += [(rank, part, side, value) for part in known[whole] for side in sides]
    found: dict[str, dict[str, float]] = {}
    for _, muscle, side, value in sorted(wanted, key=lambda entry: entry[0]):
        found.setdefault(muscle, {})[side] = value
    for by_side in found.values():
        by_side.pop(palsy, None)
    by_name = {
        f"{muscle}_{side}": found[muscle][side]
        for muscle in muscles
        for side in _SIDES
        if found.get(muscle, {}).get(side, 0.0) > 0.0
    }
    if any(by_side.get("left", 0.0) != by_side.get("right", 0.0) for by_side in found.values()):
        return by_name
    return {
        name.removesuffix("_left"): value
        for name, value in by_name.items()
        if name.endswith("_left")
    }
