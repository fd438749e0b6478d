"""The browser that looks at pages in tests; tests are skipped where there is none."""

import pytest

from scenarios.benchmarks.browser import CHROMIUM, Page, page

__all__ = ["CHROMIUM", "Page", "in_chromium", "page"]

in_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="NO BROWSER, so the pages were NOT looked at: apt-get install chromium"
)
