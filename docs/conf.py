"""Configuration of the documentation."""

from modiolus import __version__

project = "modiolus"
author = "The modiolus developers"
copyright = "The modiolus developers"  # noqa: A001
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = "modiolus"

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_rtype = False

# The types in docstrings are prose, "(n, 3) array of elements": no links are meant by them.
suppress_warnings = ["ref.python"]
