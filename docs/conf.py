"""Sphinx configuration: ``sphinx-build -n -W docs docs/_build``."""

from __future__ import annotations

from pathlib import Path

import viatool

DOCS = Path(__file__).resolve().parent

project = "viatool"
author = "The viatool authors"
project_copyright = "2026, the viatool authors"
version = release = viatool.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
]
exclude_patterns = ["_build"]
nitpicky = True

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
highlight_language = "text"
default_role = "code"
smartquotes = False  # "--eps" is not a dash

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings name the types, and say what they mean
autosummary_generate = False
numpydoc_show_class_members = False
numpydoc_validation_checks = set()

copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True

html_theme = "furo"
html_title = f"viatool {version}"
html_static_path = ["_static"]
html_css_files = ["viatool.css"]
html_extra_path = sorted(str(path) for path in DOCS.glob("*.schema.json"))  # at addresses that stay
html_show_sphinx = False
html_copy_source = False
