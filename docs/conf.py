# SPDX-License-Identifier: Apache-2.0
"""Configuration of the documentation; ``python -m sphinx -W docs out/docs`` builds it."""

import os
import re
import sys
from importlib import import_module
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

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
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True}
python_use_unqualified_type_names = True
maximum_signature_line_length = 110  # longer signatures have one parameter per line
# Aliases are shown by their names; otherwise signatures spell out all that ArrayLike allows.
ALIASES = ("ArrayLike", "DTypeLike", "NDArray", "Region")
autodoc_type_aliases = {name: name for name in ALIASES}

napoleon_google_docstring = False
# Types are text for people ("array_like, shape (row, col)"), which must not become references.
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style")]


def readable_signature(
    _app: Sphinx,
    _what: str,
    _name: str,
    _obj: Any,
    _options: Any,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Write aliases by their names, also in unions, and ``...`` for defaults that are computed."""

    def readable(text: str | None) -> str | None:
        return text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text)

    return readable(signature and signature.replace("<factory>", "...")), readable(returns)


def is_described_elsewhere(
    app: Sphinx, what: str, name: str, obj: Any, _skip: bool, _options: Any
) -> bool | None:
    """Describe each object once: at the top level, or else in the package that defines it."""
    page = app.env.docname.removeprefix("api/")
    if what != "module" or page == "hueflight":
        return None
    if name in import_module("hueflight").__all__:
        return True
    root, _, path = getattr(obj, "__module__", "").partition(".")
    package = path.partition(".")[0]
    if root != "hueflight" or package in ("", page):
        return None
    return name in getattr(import_module(f"hueflight.{package}"), "__all__", ()) or None


def setup(app: Sphinx) -> None:
    """Connect the handlers."""
    app.connect("autodoc-process-signature", readable_signature)
    app.connect("autodoc-skip-member", is_described_elsewhere)
