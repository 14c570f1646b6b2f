# SPDX-License-Identifier: Apache-2.0
"""Parts of self-contained HTML pages: style sheet, pictures and sections."""

from __future__ import annotations

import base64
import html
import io
from importlib import resources

import matplotlib as mpl
from matplotlib.figure import Figure

from hueflight.report.style import SETTINGS


def png(figure: Figure) -> bytes:
    """Return the contents of a PNG file of a figure.

    Parameters
    ----------
    figure : Figure
        The figure.

    Returns
    -------
    bytes
        The file's contents.
    """
    stream = io.BytesIO()
    with mpl.rc_context(SETTINGS):
        figure.savefig(stream, format="png", dpi=110)
    return stream.getvalue()


def style_sheet() -> str:
    """Return the style sheet that all pages share.

    Returns
    -------
    str
        Rules in CSS.
    """
    return (resources.files("hueflight.report") / "page.css").read_text("utf-8")


def picture_section(name: str, heading: str, text: str, picture: bytes) -> str:
    """Return a section with one picture, which is embedded.

    Parameters
    ----------
    name : str
        Anchor in the page.
    heading, text : str
        Heading, and what the picture shows; plain text.
    picture : bytes
        Contents of a PNG file.

    Returns
    -------
    str
        HTML.
    """
    return (
        f'<section id="{name}"><h2>{html.escape(heading)}</h2><p>{html.escape(text)}</p>'
        f'<img alt="{html.escape(heading)}" src="data:image/png;base64,'
        f'{base64.b64encode(picture).decode()}"></section>'
    )
