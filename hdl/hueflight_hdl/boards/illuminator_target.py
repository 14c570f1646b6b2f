# SPDX-License-Identifier: Apache-2.0
"""The target of the illuminator on any board, from its configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from amaranth.build import Platform
from amaranth.hdl import Elaboratable

from ..illuminator.illuminator import IlluminatorConfig
from .settings import illuminator_settings
from .target import Target


def target_of(
    config: IlluminatorConfig,
    top: Callable[[], Elaboratable],
    /,
    *,
    board: str,
    platform: Callable[[], Platform],
    family: str,
    options: Mapping[str, str] | None = None,
) -> Target:
    """Return the target of a configuration.

    Parameters
    ----------
    config : IlluminatorConfig
        What is built.
    top : callable
        Returns the top-level module with that configuration.
    board, platform, family, options
        See `Target`.

    Returns
    -------
    Target
        The illuminator on that board.
    """
    return Target(
        design="illuminator",
        board=board,
        platform=platform,
        top=top,
        clocks_mhz={"pulse": config.pulse_hz / 1e6, "sync": config.sync_hz / 1e6},
        family=family,
        registers=config.registers(),
        options=options or {},
        settings=illuminator_settings(config),
    )
