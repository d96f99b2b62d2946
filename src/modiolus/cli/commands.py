"""All commands: each module adds its own, and their order is that of the help."""

from modiolus.cli import (  # noqa: F401, I001
    simulate,
    catalogue,
    export,
    heads,
    morph,
    segment,
    upright,
    compare,
    identify,
    validate,
    verify,
    converge,
    bench,
    beam,
)
from modiolus.cli.app import app

__all__ = ["app"]
