# SPDX-License-Identifier: Apache-2.0
"""What a file is and holds, as `hueflight info` shows it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from hueflight.recognition import reason_of

CHECKED = "everything was read and agrees with its checksums"
READ = "everything was read without an error; files of this kind have no checksums"


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


def checked(
    kind: str, facts: Mapping[str, Any], check: bool, read: Callable[[], str]
) -> FileDescription:
    """Describe a file whose content is read by a function that returns the evidence.

    Parameters
    ----------
    kind : str
        What the file is.
    facts : mapping of str to Any
        What describes it.
    check : bool
        Whether to read the content.
    read : callable
        Function that reads it and says what was compared; an error means that it is not whole.

    Returns
    -------
    FileDescription
        The description.
    """
    if not check:
        return FileDescription(kind=kind, facts=facts)
    try:
        return FileDescription(kind=kind, facts=facts, whole=True, evidence=read())
    except Exception as error:  # ours or a library's: whatever it says, the content is not whole
        return FileDescription(kind=kind, facts=facts, whole=False, evidence=reason_of(error))


def array_text(shape: tuple[int, ...], dtype: Any) -> str:
    """Return shape and type of an array as text.

    Parameters
    ----------
    shape : tuple of int
        Its shape.
    dtype : Any
        Its type.

    Returns
    -------
    str
        Such as ``192 × 128 × 512 uint16``.
    """
    return f"{' × '.join(map(str, shape)) or 'one value'} {dtype}"
