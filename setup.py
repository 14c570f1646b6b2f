"""The compiled kernels; everything else about the distribution stands in pyproject.toml."""

from platform import machine

from setuptools import Extension, setup

KERNELS = "host/hueflight/ingest"
RECONSTRUCTION = "host/hueflight/reconstruction"

# the joint fit for three widths of vectors; at run time the widest that works is taken
VECTOR_BUILDS = {"_kernels": ("4", [])}
if machine() in {"x86_64", "AMD64"}:
    VECTOR_BUILDS["_kernels_v3"] = ("8", ["-march=x86-64-v3"])
    VECTOR_BUILDS["_kernels_v4"] = ("16", ["-march=x86-64-v4", "-mprefer-vector-width=512"])

setup(
    ext_modules=[
        Extension(
            "hueflight.ingest._kernels",
            sources=[f"{KERNELS}/_kernels.c"],
            depends=[
                f"{KERNELS}/_{name}.h"
                for name in ("wire", "crc32c", "scan", "rows", "tiles", "narrow", "count")
            ],
            extra_compile_args=["-O3"],
            py_limited_api=True,
            optional=True,  # without a compiler the NumPy twins take over
        ),
        *(
            Extension(
                f"hueflight.reconstruction.{name}",
                sources=[f"{RECONSTRUCTION}/_kernels.c"],
                depends=[
                    f"{RECONSTRUCTION}/_{part}.h"
                    for part in (
                        "vector",
                        "tables",
                        "scoring",
                        "search",
                        "likelihood",
                        "counts",
                        "fit",
                        "changes",
                        "abreast",
                        "correlation",
                        "paper",
                    )
                ],
                define_macros=[("MODULE", name), ("LANES", lanes)],
                # roots and logarithms need not set errno
                extra_compile_args=["-O3", "-fno-math-errno", "-fno-trapping-math", *flags],
                py_limited_api=True,
                optional=True,  # without a compiler the definition in NumPy takes over
            )
            for name, (lanes, flags) in VECTOR_BUILDS.items()
        ),
        Extension(
            "hueflight.reconstruction._pooling",
            sources=[f"{RECONSTRUCTION}/_pooling.c"],
            depends=[f"{RECONSTRUCTION}/_vector.h"],
            extra_compile_args=["-O3", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"],
            py_limited_api=True,
            optional=True,  # without a compiler the definition in NumPy takes over
        ),
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
