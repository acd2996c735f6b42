"""Debian's chromium, driven by Playwright; required in CI, elsewhere a reason to skip."""

import os
import shutil
from contextlib import contextmanager

import pytest


@pytest.fixture(scope="session")
def chromium():
    path = shutil.which("chromium")
    if path is None:
        reason = "needs chromium: apt-get install chromium"
        pytest.fail(reason) if os.environ.get("CI") else pytest.skip(reason)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def visit(chromium):
    """Opens pages; each must end without a word on the console that nobody allowed."""

    @contextmanager
    def open_page(scheme="light", offline=False, allowed=()):
        context = chromium.new_context(
            viewport={"width": 1200, "height": 800}, color_scheme=scheme, offline=offline
        )
        page, words = context.new_page(), []
        page.on("console", lambda message: words.append(message.text))
        page.on("pageerror", lambda error: words.append(str(error)))
        page.set_default_timeout(15_000)
        try:
            yield page
            left = [w for w in words if not any(part in w for part in allowed)]
            assert not left, left
        finally:
            context.close()

    return open_page
