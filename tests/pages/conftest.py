"""A real browser for the tests of pages: an installed Chromium, driven by Playwright, without any network."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NoReturn

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "chrome")
LOCAL = ("file:", "data:", "blob:", "about:", "http://127.0.0.1:")
"""Beginnings of addresses that lie on this machine."""


def refused(what: str) -> NoReturn:
    """Fail in continuous integration, which must have all that the tests need; skip elsewhere."""
    if os.environ.get("CI", "").lower() in ("1", "true"):
        pytest.fail(f"{what} (and CI is set: the tests of pages must not be skipped)")
    pytest.skip(what)


@pytest.fixture(scope="session")
def refuse() -> Callable[[str], NoReturn]:
    """Fails in continuous integration, skips elsewhere, for want of what its argument names."""
    return refused


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A headless Chromium of this machine; Playwright's own is not fetched."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        refused(f"no browser: none of {', '.join(PROGRAMS)} is found; on Debian: apt-get install chromium")
    try:
        from playwright.sync_api import sync_playwright  # noqa: PLC0415
    except ImportError:
        refused("Playwright is not installed: pip install 'sayd-env[browser]'")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program, args=["--disable-gpu"])
        yield chromium
        chromium.close()


@pytest.fixture
def visit(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Open a page of this machine at a width (px); errors in its console and a use of the network fail.

    ``visit(url, width=1280, height=900, **options)``: `url` may be ``file:///...``; the options are those of
    Playwright's ``browser.new_context``.
    """
    faults: list[str] = []
    contexts = []

    def guard(route: Route) -> None:
        if route.request.url.startswith(LOCAL):
            route.continue_()
        else:
            faults.append(f"asks the network for {route.request.url}")
            route.abort()

    def open_page(url: str, width: int = 1280, height: int = 900, **options: Any) -> Page:
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        context.route("**/*", guard)
        page = context.new_page()
        page.on("console", lambda message: message.type == "error" and faults.append(message.text))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(url)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert faults == []
