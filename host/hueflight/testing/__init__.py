# SPDX-License-Identifier: Apache-2.0
"""What a rig, an importer and an exporter of another package must do, as classes of tests.

A package inherits the class for what it adds, says in fixtures what is to be tested, and runs
pytest. The page *… add a rig, a reader or a format* of the documentation has an example.
"""

from hueflight.files.optional import import_optional

import_optional("pytest", extra="testing")

from hueflight.testing.exporter import ExporterChecks  # noqa: E402 - pytest is checked for first
from hueflight.testing.importer import ImporterChecks  # noqa: E402
from hueflight.testing.rig import RigChecks  # noqa: E402

__all__ = ["ExporterChecks", "ImporterChecks", "RigChecks"]
