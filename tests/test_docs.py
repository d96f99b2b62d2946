"""What the documents say of the code: names that are there, and options that commands have."""

import importlib
import pkgutil
import re
from functools import cache
from pathlib import Path

import pytest
from typer.main import get_command

import modiolus
from modiolus.cli.commands import app

ROOT = Path(__file__).parents[1]
#: Endings of what is a file and no name.
ENDINGS = "csv glb html json md npz ply png py toml txt usdc vtu xyz"
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]


@cache
def modules():
    """All modules by their whole name."""
    found = pkgutil.walk_packages(modiolus.__path__, "modiolus.")
    names = [item.name for item in found if not item.name.endswith("__main__")]
    return {name: importlib.import_module(name) for name in ["modiolus", *names]}


def holds(thing, names):
    """Tell whether a module or class has an attribute, or a field, under a dotted name."""
    for name in names:
        fields = getattr(thing, "__annotations__", {})
        if not hasattr(thing, name) and name not in fields:
            return False
        thing = getattr(thing, name, None)
    return True


def is_there(name):
    """Tell whether some module has what a document calls by the last parts of its name."""
    parts = name.split(".")
    for place, module in modules().items():
        known = place.split(".")
        if holds(module, parts):
            return True
        # The name may begin with parts of the module's own.
        for count in range(1, len(parts) + 1):
            if known[-count:] == parts[:count] and holds(module, parts[count:]):
                return True
    return False


def is_of_the_code(name):
    """Tell whether a dotted name is meant to be one of the package."""
    first, _, last = name.partition(".")
    own = {part for place in modules() for part in place.split(".")}
    return bool(last) and last not in ENDINGS.split() and (first in own or first[:1].isupper())


def test_stale_names_would_be_found():
    assert is_there("modiolus.mechanics.Springs") and is_there("kernels.bulk")
    assert is_there("Settings.near") and is_there("mechanics.face.face_load")
    assert is_of_the_code("kernels.gone") and not is_there("kernels.gone")
    assert is_of_the_code("Settings.gone") and not is_there("Settings.gone")
    assert not is_of_the_code("face.png")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_names_in_the_documents_are_there(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    names = {name.lstrip("~") for name in re.findall(r"`([~\w.]+)(?:\([^`]*\))?`", text)}
    assert [name for name in sorted(names) if is_of_the_code(name) and not is_there(name)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_the_documents_have_their_options(page):
    groups = {"": get_command(app).commands}
    groups["head"] = groups[""]["head"].commands
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    for line in re.findall(r"(?:^|`)modiolus ([a-z][^`\n#]*)", text, flags=re.MULTILINE):
        first, *rest = line.split()
        if first not in groups[""]:
            # Prose that begins with the name of the package.
            continue
        command = groups[""][first]
        if first == "head" and rest and rest[0] in groups["head"]:
            command = groups["head"][rest[0]]
        known = {option for part in command.params for option in part.opts} | {"--help"}
        given = {word.split("=")[0] for word in rest if word.startswith("--")}
        assert given <= known, f"modiolus {line}"
