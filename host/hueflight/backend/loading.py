# SPDX-License-Identifier: Apache-2.0
"""Find, check and load the extension modules that hold the compiled kernels."""

from __future__ import annotations

import os
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from types import MappingProxyType, ModuleType

from hueflight.backend import fit, ingest, pooled, sums
from hueflight.backend.interface import Interface
from hueflight.errors import KernelError, SlowKernelsWarning

VARIABLE = "HUEFLIGHT_KERNELS"


@dataclass(frozen=True)
class Kernel:
    """A set of compiled functions, and the extension modules that hold it.

    Attributes
    ----------
    name : str
        What the rest of Hueflight calls it.
    purpose : str
        What its functions do, for people.
    builds : tuple of str
        Modules that hold the same functions for different processors, the fastest first. If there
        are several, the last one runs on every processor, and its function ``processor()`` tells
        how many of the faster ones this processor supports.
    interface : Interface
        What C and Python agree on.
    """

    name: str
    purpose: str
    builds: tuple[str, ...]
    interface: Interface


#: every kernel, by name
KERNELS = MappingProxyType(
    {
        kernel.name: kernel
        for kernel in (
            Kernel(
                "ingest",
                "packets to histograms",
                ("hueflight.ingest._kernels",),
                ingest.INTERFACE,
            ),
            Kernel(
                "fit",
                "joint fit and correlation",
                tuple(f"hueflight.fit._kernels{level}" for level in ("_v4", "_v3", "")),
                fit.INTERFACE,
            ),
            Kernel(
                "pooled",
                "adaptive neighbourhoods",
                ("hueflight.reconstruction.pooled._kernels",),
                pooled.INTERFACE,
            ),
            Kernel(
                "sums",
                "estimates from sums",
                ("hueflight.reconstruction.sums._kernels",),
                sums.INTERFACE,
            ),
        )
    }
)


@dataclass(frozen=True)
class _Loaded:
    """A module, or the reason why there is none; `broken` if installing again would help."""

    module: ModuleType | None
    reason: str = ""
    broken: bool = False


def requested() -> str:
    """Return the value of ``HUEFLIGHT_KERNELS``.

    Returns
    -------
    str
        ``"c"``, ``"numpy"``, or empty where the choice is left to Hueflight.

    Raises
    ------
    KernelError
        If the variable has another value.
    """
    return _checked(os.environ.get(VARIABLE, ""), VARIABLE)


def _checked(wish: str, where: str) -> str:
    if wish not in ("", "c", "numpy"):
        raise KernelError(
            f"{where} = {wish!r}: must be 'c' or 'numpy', or not given, to use the compiled "
            "kernels where they were built"
        )
    return wish


def compiled(name: str, /, implementation: str | None = None) -> ModuleType | None:
    """Return the compiled module to use for a kernel.

    Parameters
    ----------
    name : str
        A key of `KERNELS`.
    implementation : str, optional
        ``"c"`` or ``"numpy"``; by default what ``HUEFLIGHT_KERNELS`` asks for.

    Returns
    -------
    module or None
        None where the NumPy definition is to be used: because it was asked for, or because there
        is nothing compiled and nobody insists on it. In that last case a process is warned once.

    Raises
    ------
    KernelError
        If ``HUEFLIGHT_KERNELS`` is invalid or asks for what is not there, or if the compiled
        module does not match the installed Python code.

    Warns
    -----
    SlowKernelsWarning
        If nothing is compiled and nobody said that this is meant.
    """
    module, wish = _chosen(name, implementation)
    if module is None and not wish:
        _warn_of_slowness()
    return module


@cache
def _warn_of_slowness() -> None:
    """Warn once that all will be slow; `hueflight --version` says more."""
    warnings.warn(
        "Hueflight was installed without its compiled kernels; their NumPy definitions give the "
        "same results many times slower. `hueflight --version` says why. Install the package "
        f"again where there is a C compiler, or set {VARIABLE}=numpy if this is meant",
        SlowKernelsWarning,
        stacklevel=3,
    )


def _chosen(name: str, implementation: str | None = None) -> tuple[ModuleType | None, str]:
    """Return the module to use, if any, and what was asked for."""
    where = VARIABLE if implementation is None else "implementation"
    wish = requested() if implementation is None else _checked(implementation, where)
    if wish == "numpy":
        return None, wish
    loaded = _load(name)
    if loaded.broken:
        raise KernelError(loaded.reason)
    if loaded.module is None and wish == "c":
        raise KernelError(f"{where} = 'c', but {loaded.reason}")
    return loaded.module, wish


def available(name: str, /) -> bool:
    """Tell whether a kernel was compiled and fits, whatever ``HUEFLIGHT_KERNELS`` asks for.

    Parameters
    ----------
    name : str
        A key of `KERNELS`.

    Returns
    -------
    bool
        True if the compiled kernel can be used.
    """
    return _load(name).module is not None


def why_not(name: str, /) -> str:
    """Tell why a kernel is not available.

    Parameters
    ----------
    name : str
        A key of `KERNELS`.

    Returns
    -------
    str
        The reason, or an empty string if the kernel is available.
    """
    return _load(name).reason


def describe() -> dict[str, str]:
    """Describe which kernels run, and why; for people to read.

    Returns
    -------
    dict of str to str
        A text for each key of `KERNELS`, such as ``"compiled (hueflight.fit._kernels_v4)"`` or
        ``"NumPy, since HUEFLIGHT_KERNELS = 'numpy'"``. Faults are described, not raised.
    """
    return {name: _described(name) for name in KERNELS}


def _described(name: str) -> str:
    try:
        module, _ = _chosen(name)
    except KernelError as error:
        return f"unusable: {error}"
    if module is not None:
        return f"compiled ({module.__name__})"
    reason = f"{VARIABLE} = 'numpy'" if requested() == "numpy" else why_not(name)
    return f"NumPy, since {reason}"


@cache
def _load(name: str) -> _Loaded:
    """Load the fastest build of a kernel that this processor runs."""
    kernel = KERNELS[name]
    import_module(kernel.builds[-1].rpartition(".")[0])  # errors of the package are its own
    try:
        base = import_module(kernel.builds[-1])
    except ImportError as error:
        return _Loaded(
            None,
            f"{kernel.builds[-1]} was not compiled ({error}): install the package again where "
            f"there is a C compiler, or set {VARIABLE}=numpy to go on without",
        )
    chosen, others = base, kernel.builds[:-1]
    if others and _matches(base, kernel.interface):
        for build in others[len(others) - base.processor() :]:
            with suppress(ImportError):  # the compiler did not know this processor
                chosen = import_module(build)
                break
    if _matches(chosen, kernel.interface):
        return _Loaded(chosen)
    return _Loaded(
        None,
        f"{chosen.__name__} was built from other sources than the installed Python code (interface "
        f"{getattr(chosen, 'ABI', 'unknown')}, not {kernel.interface.hash}): install the package "
        f"again, or set {VARIABLE}=numpy to go on without",
        broken=True,
    )


def _matches(module: ModuleType, interface: Interface) -> bool:
    return getattr(module, "ABI", None) == interface.hash
