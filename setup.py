"""The compiled kernels; everything else about the distribution stands in pyproject.toml."""

from setuptools import Extension, setup

KERNELS = "host/hueflight/ingest"

setup(
    ext_modules=[
        Extension(
            "hueflight.ingest._kernels",
            sources=[f"{KERNELS}/_kernels.c"],
            depends=[f"{KERNELS}/_{name}.h" for name in ("wire", "crc32c", "scan", "count")],
            extra_compile_args=["-O3"],
            py_limited_api=True,
            optional=True,  # without a compiler the NumPy twins take over
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
