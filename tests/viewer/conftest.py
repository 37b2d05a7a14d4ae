"""The browser of this folder's tests."""

import os
import socket

import pytest

from tests.viewer.browser import PROGRAMS, find_chromium, headless


@pytest.fixture(scope="module")
def browser():
    """A headless browser; without one installed a test is skipped, in CI it fails."""
    program = find_chromium()
    if program is None:
        message = f"no browser is installed: one of {', '.join(PROGRAMS)} (apt-get install chromium)"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(message)
        pytest.skip(message)
    with headless(program) as running:
        yield running


@pytest.fixture
def free_port() -> int:
    """A port that nothing listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
