"""What the tests of pages share: one browser, opened when it is first needed."""

import pytest

from tests.view.browser import page


@pytest.fixture(scope="session")
def browser():
    with page() as opened:
        yield opened
