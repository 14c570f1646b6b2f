# SPDX-License-Identifier: Apache-2.0
"""Facts about the project that stand in several files agree, and each file says its license."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SPDX = "SPDX-License-Identifier: Apache-2.0"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def tracked(*patterns: str) -> list[Path]:
    done = subprocess.run(
        ["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        pytest.skip("not a clone: git does not know the files")
    return [ROOT / name for name in done.stdout.split()]


def test_every_source_file_names_its_license():
    files = tracked("*.py", "*.c", "*.h", "*.cc", "*.sv", "*.js", "*.mjs", "*.css")
    assert len(files) > 600
    missing = [
        path.relative_to(ROOT).as_posix()
        for path in files
        if path.exists() and SPDX not in path.read_text(encoding="utf-8")[:200]
    ]
    assert not missing


def test_the_citation_agrees_with_the_package():
    yaml = pytest.importorskip("yaml", reason="needs PyYAML")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert [author["name"] for author in citation["authors"]] == [
        author["name"] for author in PROJECT["authors"]
    ]
    published = citation["references"][0]["doi"]
    assert PROJECT["urls"]["Paper"].endswith(published)


def test_notice_names_every_data_file_in_the_package():
    notice = (ROOT / "NOTICE").read_text()
    data = [path.relative_to(ROOT).as_posix() for path in tracked("host/*.csv")]
    assert data
    assert [name for name in data if name not in notice] == []
    named = re.findall(r"^- (\S+):", notice, re.MULTILINE)
    assert all((ROOT / name).exists() for name in named)


def test_the_readme_says_what_every_extra_adds():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    table = readme[readme.index("| extra |") : readme.index("[Platforms]")]
    named = re.findall(r"^\| `(\S+)` \| \w", table, re.MULTILINE)
    assert sorted(named) == sorted(PROJECT["optional-dependencies"])


def test_the_changelog_has_a_section_for_the_version():
    sections = re.findall(r"^## ([0-9.]+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert PROJECT["version"] in sections
