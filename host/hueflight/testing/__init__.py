# SPDX-License-Identifier: Apache-2.0
"""What a rig, a readout, an importer and an exporter of others must do, as classes of tests.

A package inherits the class for what it adds, says in fixtures what is to be tested, and runs
pytest. The page *… add a rig, a reader or a format* of the documentation has an example.
"""

from typing import TYPE_CHECKING

from hueflight.files.optional import import_optional
from hueflight.lazy import lazy_names

if TYPE_CHECKING:
    from hueflight.testing.exporter import ExporterChecks
    from hueflight.testing.importer import ImporterChecks
    from hueflight.testing.rig import RigChecks
    from hueflight.testing.sensor_port import SensorPortChecks

__all__ = ["ExporterChecks", "ImporterChecks", "RigChecks", "SensorPortChecks"]

import_optional("pytest", extra="testing")  # the modules of the classes import it

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "ExporterChecks": "hueflight.testing.exporter",
        "ImporterChecks": "hueflight.testing.importer",
        "RigChecks": "hueflight.testing.rig",
        "SensorPortChecks": "hueflight.testing.sensor_port",
    },
)
