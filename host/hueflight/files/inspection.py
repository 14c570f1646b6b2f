# SPDX-License-Identifier: Apache-2.0
"""What a file is and holds, as `hueflight info` shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class FileDescription:
    """Kind and content of a file, and whether it is whole.

    Attributes
    ----------
    kind : str
        What the file is, such as ``"recording of packets"``.
    facts : mapping of str to Any
        Plain values that describe the content.
    whole : bool or None
        True if all of the content was read and is intact, False if something is missing or
        damaged, None if the content was not checked.
    evidence : str
        What `whole` rests on: what was compared, or what is damaged.
    """

    kind: str
    facts: Mapping[str, Any]
    whole: bool | None = None
    evidence: str = "only the description was read; --check reads everything"

    def as_dict(self) -> dict[str, Any]:
        """Return everything as one dictionary, ready for JSON.

        Returns
        -------
        dict
            ``kind``, all facts, ``whole`` and ``evidence``.
        """
        return {
            "kind": self.kind,
            **self.facts,
            "whole": self.whole,
            "evidence": self.evidence,
        }
