# SPDX-License-Identifier: Apache-2.0
"""The compiled kernels; everything else about the distribution is in pyproject.toml."""

import os
from pathlib import Path
from sysconfig import get_platform

from setuptools import Extension, setup

PACKAGES = Path("host/hueflight")
SHARED = PACKAGES / "backend" / "_c"  # headers of several kernels
#: without a compiler the NumPy definitions are used, except where a release is built
OPTIONAL = not os.environ.get("HUEFLIGHT_REQUIRE_KERNELS")
NO_ERRNO = "-fno-math-errno"  # roots and logarithms need not set errno


def kernels(package: str, *, name: str = "_kernels", flags: tuple[str, ...] = (), **options):
    """The extension `hueflight.<package>.<name>`, built from that package's `_c` folder."""
    folder = PACKAGES.joinpath(*package.split(".")) / "_c"
    headers = [*folder.glob("*.h"), *SHARED.glob("*.h")]
    return Extension(
        f"hueflight.{package}.{name}",
        sources=[str(folder / "kernels.c")],
        depends=sorted(str(header) for header in headers),
        include_dirs=[str(SHARED)],
        extra_compile_args=["-O3", *flags],
        py_limited_api=True,
        optional=OPTIONAL,
        **options,
    )


# The joint fit is built for three vector widths; the widest that the processor supports is loaded.
FIT_BUILDS: dict[str, tuple[str, list[str]]] = {"_kernels": ("4", [])}
if get_platform().endswith(("x86_64", "amd64")):  # what is built for, also by a cross compiler
    FIT_BUILDS["_kernels_v3"] = ("8", ["-march=x86-64-v3"])
    FIT_BUILDS["_kernels_v4"] = (
        "16",
        [
            *("-march=x86-64-v4", "-mprefer-vector-width=512"),
            "-mtune=icelake-server",  # orders instructions: 4 to 5 % faster, also on a Zen 4
        ],
    )

setup(
    ext_modules=[
        kernels("ingest"),
        *(
            kernels(
                "fit",
                name=name,
                flags=(NO_ERRNO, "-fno-trapping-math", *march),
                define_macros=[("MODULE", name), ("LANES", lanes)],
            )
            for name, (lanes, march) in FIT_BUILDS.items()
        ),
        *(
            kernels(package, flags=(NO_ERRNO, "-fno-trapping-math", "-Wno-psabi"))
            for package in ("reconstruction.pooled", "reconstruction.sums")
        ),
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
