# SPDX-License-Identifier: Apache-2.0
"""The files of the live page as the daemon serves them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hueflight.color.colormap import colours
from hueflight.daemon.page_files import COLORMAP_FILE, page_files

IMPORT = re.compile(r'from "\./([^"]+)"')


def modules() -> dict[str, set[str]]:
    """Names of the page's modules, and the modules that each of them imports."""
    return {
        name: set(IMPORT.findall(content.decode()))
        for name, content in page_files().items()
        if name.endswith(".js")
    }


def test_every_imported_module_is_served_and_every_module_is_imported() -> None:
    imports = modules()
    imported = set().union(*imports.values())
    assert imported <= set(imports)
    assert set(imports) - imported == {"main.js", "cameras.js"}  # of each page


def test_no_module_imports_itself_by_way_of_others() -> None:
    imports = modules()
    while imports:
        ready = {name for name, needed in imports.items() if not needed & set(imports)}
        assert ready, f"a circle among {sorted(imports)}"
        imports = {name: needed for name, needed in imports.items() if name not in ready}


@pytest.mark.parametrize("place", [0, 1, 100, 254, 255])
def test_the_page_has_the_colour_map_of_the_package(place: int) -> None:
    [digits] = re.findall(r'"([0-9a-f]+)"', page_files()[COLORMAP_FILE].decode())
    table = np.frombuffer(bytes.fromhex(digits), np.uint8).reshape(256, 3)
    assert (table[place] == colours(np.array([[place / 255]]), 0, 1)[0, 0]).all()
