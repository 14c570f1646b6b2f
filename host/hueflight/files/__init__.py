# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all, their checksums, and the layout of an image."""

from hueflight.files.atomic import (
    PARTIAL_SUFFIX,
    describe_existing,
    make_parent,
    refuse_existing,
    replace_file,
    staged,
)
from hueflight.files.checksums import require_checksums, verify_checksums, write_checksums
from hueflight.files.optional import import_optional

#: Zarr format of every store that is written here: every Zarr library reads it, and format 3 has
#: no settled way to store fixed-length strings such as the names of bands
ZARR_FORMAT = 2

__all__ = [
    "PARTIAL_SUFFIX",
    "ZARR_FORMAT",
    "describe_existing",
    "import_optional",
    "make_parent",
    "refuse_existing",
    "replace_file",
    "require_checksums",
    "staged",
    "verify_checksums",
    "write_checksums",
]
