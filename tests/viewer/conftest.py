"""The page without a file, for the tests that open files in a browser."""

from __future__ import annotations

import pytest

from touchfield.viewer.browser import empty_page


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of the page without a file."""
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(empty_page(), encoding="utf-8")
    return path.as_uri()
