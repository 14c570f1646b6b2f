# SPDX-License-Identifier: Apache-2.0
"""A directive that executes the code of a page while the documentation is built.

The blocks of a page that are marked ``{run} python`` or ``{run} bash`` are executed in their order:
Python code in one namespace, shell commands in one temporary folder. A block with ``:file: NAME``
is written to that file in the folder instead. Output and Matplotlib figures appear below the block.
A block that fails makes the build fail.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

LONGEST_SECONDS = 300


class Page:
    """Namespace, temporary folder and figures that the blocks of one page share."""

    def __init__(self, files: list[Path]) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="hueflight-docs-"))
        self.names: dict[str, Any] = {"__name__": "__main__"}
        self.figures = 0
        for file in files:
            shutil.copy(file, self.folder)

    def run_python(self, code: str, where: str) -> str:
        """Execute Python code and return what it printed."""
        printed = io.StringIO()
        before = Path.cwd()
        os.chdir(self.folder)
        try:
            with contextlib.redirect_stdout(printed):
                exec(compile(code, where, "exec"), self.names)
        finally:
            os.chdir(before)
        return printed.getvalue()

    def run_bash(self, code: str) -> str:
        """Execute shell commands until one fails and return what they printed."""
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
        with subprocess.Popen(
            ["bash", "-euo", "pipefail", "-c", code],
            cwd=self.folder,
            env={**os.environ, "PATH": path, "COLUMNS": "88", "NO_COLOR": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as shell:
            try:
                printed, _ = shell.communicate(timeout=LONGEST_SECONDS)
            except subprocess.TimeoutExpired:
                # programs that the commands started hold the pipe too: end the whole group
                os.killpg(shell.pid, signal.SIGKILL)
                raise
        if shell.returncode:
            raise RuntimeError(f"exit code {shell.returncode}:\n{printed}")
        return printed

    def new_figures(self, folder: Path, stem: str) -> list[str]:
        """Save open figures into `folder` and return their file names."""
        if "matplotlib" not in sys.modules:
            return []
        from matplotlib import pyplot

        saved = []
        for number in pyplot.get_fignums():
            self.figures += 1
            name = f"{stem}-{self.figures}.png"
            pyplot.figure(number).savefig(folder / name, dpi=110, bbox_inches="tight")
            saved.append(name)
        pyplot.close("all")
        return saved


class Run(SphinxDirective):
    """The directive ``{run} LANGUAGE``."""

    has_content = True
    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {
        "file": directives.unchanged_required,
        "alt": directives.unchanged,
        "hide-output": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Return nodes for the code, its output and its figures."""
        language, code = self.arguments[0], "\n".join(self.content)
        page = self._page()
        source, line = self.get_source_info()
        shown = nodes.literal_block(code, code, language=language)
        result: list[nodes.Node] = [shown]
        if name := self.options.get("file"):
            (page.folder / name).write_text(code + "\n", encoding="utf-8")
            caption = nodes.caption("", "", nodes.literal("", name))
            return [nodes.container("", caption, shown, literal_block=True)]
        try:
            if language == "python":
                printed = page.run_python(code, f"{source}:{line}")
            elif language == "bash":
                printed = page.run_bash(code)
            else:
                raise self.error(f"{language!r} can't be run: python or bash")
        except Exception:  # any exception is a fault of the page
            raise self.severe(f"a block failed:\n{traceback.format_exc(limit=-3)}") from None
        if printed.strip() and "hide-output" not in self.options:
            result.append(nodes.literal_block(printed, printed, language="text"))
        folder = Path(self.env.srcdir) / "_generated"
        folder.mkdir(exist_ok=True)
        for figure in page.new_figures(folder, self.env.docname.replace("/", "-")):
            image = nodes.image(uri=f"/_generated/{figure}", alt=self.options.get("alt", ""))
            self.env.note_dependency(str(folder / figure))
            result.append(image)
        return result

    def _page(self) -> Page:
        pages: dict[str, Page] = self.env.temp_data.setdefault("executed", {})
        if self.env.docname not in pages:
            files = [Path(self.env.srcdir) / name for name in self.config.executed_files]
            pages[self.env.docname] = Page(files)
        return pages[self.env.docname]


def clean_up(app: Sphinx, document: nodes.document) -> None:
    """Remove the temporary folder of a page that has been read."""
    for page in app.env.temp_data.get("executed", {}).values():
        shutil.rmtree(page.folder, ignore_errors=True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_config_value("executed_files", [], "env", list)
    app.add_directive("run", Run)
    app.connect("doctree-read", clean_up)
    # pages share neither figures nor folders, so that they may be read in parallel
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
