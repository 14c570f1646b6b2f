# SPDX-License-Identifier: Apache-2.0
"""Memory runs out while a recording, an image or an output is made: nothing is lost or left."""

from collections.abc import Callable
from types import ModuleType

import pytest

from hueflight.recording import RecordingWriter

pytest.importorskip("_testcapi", reason="this interpreter lacks its own tests' module _testcapi")

Evidence = Callable[[str], ModuleType]


def test_what_is_counted_is_there(evidence: Evidence) -> None:
    memory = evidence("memory")
    outcomes, findings = memory.run(step=memory.QUICK_STEP)
    assert findings == []
    assert min(outcomes[name] for name in ("complete", "refused", "counted")) > 5


def test_packets_that_are_forgotten_are_found(
    evidence: Evidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RecordingWriter, "_fail", lambda *_, **__: None)
    memory = evidence("memory")
    _, findings = memory.run(step=memory.QUICK_STEP)
    assert any("no error says so" in finding for finding in findings)


@pytest.mark.slow
def test_results_are_complete_or_refused(evidence: Evidence) -> None:
    results = evidence("memory_of_results")
    report = results.report(quick=True)
    assert report.findings == []
    outcomes, _ = results.run(fineness=1, only=["write csv"])
    assert outcomes["refused"] > 5


@pytest.mark.slow
def test_what_is_left_is_found(evidence: Evidence, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hueflight.files.atomic._discard", lambda folder, *, at_once: None)
    _, findings = evidence("memory_of_results").run(fineness=1, only=["write csv"])
    assert any("left after" in finding for finding in findings)
