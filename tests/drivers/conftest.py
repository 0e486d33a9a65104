from __future__ import annotations

from collections.abc import Iterator

import pytest

from .host import Host, make_host


@pytest.fixture
def host() -> Iterator[Host]:
    """An open link to a booted bench; nothing is prepared."""
    made = make_host()
    yield made
    made.link.close()
