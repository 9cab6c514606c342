"""The built site in a real browser: pages load without the network, search works, a phone can read it."""

from __future__ import annotations

import functools
import http.server
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page

SITE = Path(__file__).parents[2] / "build" / "site"
PHONE = 390
"""Width of a phone (CSS px)."""


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture(scope="module")
def pages(refuse: Callable[[str], None]) -> list[str]:
    """Every page of the built site, relative to it."""
    if not (SITE / "index.html").is_file():
        refuse("the site is not built: make docs")
    return sorted(page.relative_to(SITE).as_posix() for page in SITE.rglob("*.html"))


@pytest.fixture(scope="module")
def address(pages: list[str]) -> Iterator[str]:
    """Where the site is served."""
    handler = functools.partial(_Quiet, directory=SITE)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


def test_every_page_loads_and_fits(pages: list[str], address: str, visit: Callable[..., Page]) -> None:
    from playwright.sync_api import TimeoutError  # noqa: PLC0415 - not everybody has a browser

    page = visit(address + "index.html")
    for name in pages:
        if name == "404.html":  # which a server shows under any address: its links begin at the root
            continue
        answer = page.goto(address + name)
        assert answer is not None
        assert answer.ok, name
        assert page.locator("h1").first.inner_text(), name
        assert page.evaluate("[...document.images].filter(i => i.complete && !i.naturalWidth).length") == 0, (
            name
        )
        for width in (PHONE, 1280):
            page.set_viewport_size({"width": width, "height": 844})
            # The theme's script lets wide tables scroll in themselves, on a busy machine a moment later.
            with suppress(TimeoutError):
                page.wait_for_function(f"document.documentElement.scrollWidth <= {width}", timeout=5000)
            assert page.evaluate("document.documentElement.scrollWidth") <= width, f"{name} at {width} px"


def find(page: Page, words: str) -> list[str]:
    """Addresses that the search finds for some words, the best first."""
    page.locator(".md-search__input").click()
    page.locator(".md-search__input").press_sequentially(words)
    links = page.locator(".md-search-result__item a.md-search-result__link")
    links.first.wait_for(state="visible")
    return [str(link.get_attribute("href")) for link in links.all()]


@pytest.mark.parametrize("where", ["a server", "the disk"])
def test_search_finds_a_key_and_opens_its_page(where: str, address: str, visit: Callable[..., Page]) -> None:
    page = visit((address if where == "a server" else f"{SITE.as_uri()}/") + "index.html")
    found = next(link for link in find(page, "tape_to_back") if "configuration/profiles.html?h=tape" in link)
    page.locator(f'a[href="{found}"]').click()
    page.locator("article mark", has_text="tape_to_back").first.wait_for(state="visible")


def test_a_phone_searches_and_opens_the_contents(address: str, visit: Callable[..., Page]) -> None:
    page = visit(address + "index.html", width=PHONE, height=844)
    page.locator("header label[for=__drawer]").click()
    page.locator(".md-nav--primary label", has_text="Theory").first.click()
    page.locator(".md-nav--primary a", has_text="The model").first.click()
    page.wait_for_url("**/model.html")
    page.locator("header label[for=__search]").first.click()
    assert any(link.split("?")[0].endswith("commands/soak.html") for link in find(page, "sayd soak"))


def test_wide_tables_scroll_in_themselves(address: str, visit: Callable[..., Page]) -> None:
    page = visit(address + "commands.html", width=PHONE)
    frame = page.locator(".md-typeset__scrollwrap").first
    assert frame.evaluate("each => each.scrollWidth > each.clientWidth")
    frame.evaluate("each => each.scrollBy(50, 0)")
    assert frame.evaluate("each => each.scrollLeft") == 50


def test_a_command_and_its_figure_are_a_click_away(address: str, visit: Callable[..., Page]) -> None:
    page = visit(address + "commands.html")
    page.locator("article a", has_text="sayd critical-speed").first.click()
    page.wait_for_url("**/commands/critical-speed.html")
    page.goto(address + "claims.html")
    page.locator("article td a", has_text="P8").first.click()
    page.wait_for_url("**/figures.html#figure-10")
    assert page.locator("#figure-10").is_visible()
