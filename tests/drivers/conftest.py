from collections.abc import Iterator

import pytest

from .dbc_host import DbcHost, make_dbc_host
from .host import OPENED, Host, make_host
from .serial_host import SerialHost, make_serial_host


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    while OPENED:
        OPENED.pop().close()


@pytest.fixture
def host() -> Host:
    """An open link to a booted bench; nothing is prepared."""
    return make_host()


@pytest.fixture
def dbc() -> DbcHost:
    """As ``host``, with a drive that has frames of its own."""
    return make_dbc_host()


@pytest.fixture
def serial() -> SerialHost:
    """As ``host``, on serial lines."""
    return make_serial_host()
