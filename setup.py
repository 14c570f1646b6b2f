"""The compiled kernels; everything else about the distribution stands in pyproject.toml."""

from setuptools import Extension, setup

KERNELS = "host/hueflight/ingest"
RECONSTRUCTION = "host/hueflight/reconstruction"

setup(
    ext_modules=[
        Extension(
            "hueflight.ingest._kernels",
            sources=[f"{KERNELS}/_kernels.c"],
            depends=[
                f"{KERNELS}/_{name}.h" for name in ("wire", "crc32c", "scan", "rows", "count")
            ],
            extra_compile_args=["-O3"],
            py_limited_api=True,
            optional=True,  # without a compiler the NumPy twins take over
        ),
        Extension(
            "hueflight.reconstruction._kernels",
            sources=[f"{RECONSTRUCTION}/_kernels.c"],
            depends=[
                f"{RECONSTRUCTION}/_{name}.h"
                for name in ("vector", "tables", "scoring", "search", "likelihood")
            ],
            # roots and logarithms need not set errno; compiled for three widths of vectors, whose
            # passing between functions never leaves the file
            extra_compile_args=["-O3", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"],
            py_limited_api=True,
            optional=True,  # without a compiler the definition in NumPy takes over
        ),
        Extension(
            "hueflight.reconstruction._pooling",
            sources=[f"{RECONSTRUCTION}/_pooling.c"],
            # vectors that are passed between functions never leave the file
            extra_compile_args=["-O3", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"],
            py_limited_api=True,
            optional=True,
        ),
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
