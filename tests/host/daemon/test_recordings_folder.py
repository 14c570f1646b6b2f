"""No name from a client leads out of the data folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hueflight.daemon.recordings_folder import FileNameError, Folder


@given(st.text(max_size=80))
@example("../../etc/passwd")
@example("a/b")
@example("a\\b")
@example("a\0b")
@example(".hidden")
@example("a.mcap/../../x")
@example("a\n")
def test_a_name_stays_in_the_folder_or_is_refused(
    tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    root = tmp_path_factory.getbasetemp() / "names"
    folder = Folder(root)
    try:
        path = folder.path(name)
    except FileNameError:
        return
    assert path.parent == root.resolve()
    assert path.name == f"{name}.mcap"


def test_links_that_lead_out_are_refused(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "data")
    (tmp_path / "data" / "link.mcap").symlink_to(tmp_path / "elsewhere.mcap")
    with pytest.raises(FileNameError, match="outside the data folder"):
        folder.path("link")


def test_names_are_used_once_and_listed(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    (tmp_path / "a.mcap").write_bytes(b"12345")
    (tmp_path / "a.0001.mcap").write_bytes(b"123")
    (tmp_path / "b.mcap.part").write_bytes(b"")
    assert folder.fresh("c").name == "c.mcap"
    for taken in ("a", "b"):
        with pytest.raises(FileNameError, match="already"):
            folder.fresh(taken)
    assert [(e["name"], e["bytes"], e["segments"]) for e in folder.listing()] == [("a", 8, 2)]
