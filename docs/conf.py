"""How the documentation is built: ``python -m sphinx -W docs out/docs``."""

import os
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "agg")
sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "Hueflight"
author = "the Hueflight contributors"
copyright = author  # noqa: A001 - Sphinx's name
release = version = installed_version("hueflight")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "executed",
]
exclude_patterns = ["_build", "_generated"]
html_theme = "furo"
html_title = "Hueflight"
html_static_path: list[str] = []

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
executed_files = ["tutorials/small.toml"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
