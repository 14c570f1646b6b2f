# SPDX-License-Identifier: Apache-2.0
"""Pictures are encoded while the next one is made: in order, none left out, faults told."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from hueflight.daemon.http.picture_encoding import PictureEncoding

WAIT_S = 60.0


def picture(number: int) -> Any:
    made = SimpleNamespace(number=number)
    made.without_histogram = lambda: made
    return made


@pytest.fixture
def may_go_on() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


def test_the_next_picture_waits_for_the_one_before(may_go_on: threading.Event) -> None:
    done: list[int] = []

    def encode(one: Any) -> None:
        assert may_go_on.wait(WAIT_S)
        done.append(one.number)

    encoding = PictureEncoding(encode)
    encoding.offer(picture(1))  # does not wait
    assert done == []
    second = threading.Thread(target=encoding.offer, args=(picture(2),))
    second.start()
    second.join(0.05)
    assert second.is_alive()
    may_go_on.set()
    second.join(WAIT_S)
    encoding.offer(picture(3))
    encoding.close()
    assert done == [1, 2, 3]


def test_a_fault_is_told_with_the_next_picture() -> None:
    def encode(one: Any) -> None:
        if one.number == 1:
            raise ZeroDivisionError

    encoding = PictureEncoding(encode)
    encoding.offer(picture(1))
    with pytest.raises(ZeroDivisionError):
        encoding.offer(picture(2))
    encoding.offer(picture(3))  # begun anew
    encoding.close()
