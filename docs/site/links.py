"""The check of the built site: pages load nothing from other hosts, and all links and anchors are valid.

Of links to other hosts only the form is checked, without network access.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

FETCHED = {
    "script": ("src",),
    "link": ("href",),
    "img": ("src", "srcset"),
    "iframe": ("src",),
    "source": ("src", "srcset"),
    "video": ("src", "poster"),
    "audio": ("src",),
    "object": ("data",),
    "embed": ("src",),
    "use": ("href", "xlink:href"),
    "image": ("href", "xlink:href"),
}
"""Attributes by which a page fetches something when it is opened; a plain link fetches when it is followed."""
STYLE = re.compile(r"url\(\s*['\"]?([^'\")]+)|@import\s+['\"]([^'\"]+)")
HOST = re.compile(r"https?://[a-z0-9.-]+\.[a-z]{2,}(/\S*)?", re.IGNORECASE)
INLINE = ("data", "mailto")


class Page(HTMLParser):
    """The anchors and links of a page, and the files that it loads."""

    def __init__(self) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self._styled = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record the anchors, links and sources of one element."""
        values = {name: value for name, value in attrs if value is not None}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        self.fetched += [values[name] for name in FETCHED.get(tag, ()) if name in values]
        self.fetched += styled(values.get("style", ""))
        self._styled = tag == "style"

    def handle_endtag(self, tag: str) -> None:
        """Leave a style sheet."""
        self._styled = False

    def handle_data(self, data: str) -> None:
        """Record the files that a style sheet in the page loads."""
        if self._styled:
            self.fetched += styled(data)


def styled(text: str) -> list[str]:
    """Return the addresses of the files that a style sheet loads."""
    return [first or second for first, second in STYLE.findall(text)]


@cache
def parsed(path: Path) -> Page:
    """Return the parsed page. Each page is read once."""
    page = Page()
    page.feed(path.read_text("utf-8"))
    return page


def faults(folder: Path) -> Iterator[str]:
    """Yield a sentence for each file that a page loads from another host, and for each broken link."""
    for path in sorted(folder.rglob("*.html")):
        page, name = parsed(path), path.relative_to(folder).as_posix()
        yield from (f"{name} fetches {url}" for url in page.fetched if elsewhere(url))
        yield from (f"{name} fetches {url}, which is not there" for url in page.fetched if missing(path, url))
        for url in page.links:
            if reason := dead(path, url):
                yield f"{name} links to {url}: {reason}"
    for path in sorted((*folder.rglob("*.css"), *folder.rglob("*.svg"))):
        text = path.read_text("utf-8")
        yield from (f"{path.relative_to(folder)} fetches {url}" for url in styled(text) if elsewhere(url))


def elsewhere(url: str) -> bool:
    """Return True if a source is on another host."""
    parts = urlsplit(url)
    return bool(parts.netloc) or (bool(parts.scheme) and parts.scheme not in INLINE)


def missing(page: Path, url: str) -> bool:
    """Return True if a source on the site does not exist."""
    parts = urlsplit(url)
    return (
        not parts.scheme and not parts.netloc and bool(parts.path) and not (page.parent / unquote(parts.path)).exists()
    )


def dead(page: Path, url: str) -> str:
    """Return the reason why a link is broken, or "" if it is valid."""
    parts = urlsplit(url)
    if parts.scheme in INLINE:
        return ""
    if parts.scheme or parts.netloc:
        return "" if HOST.fullmatch(url) else "this is not an address"
    target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    if target.is_dir():
        target /= "index.html"
    if not target.exists():
        return "there is no such file"
    if parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in parsed(target).anchors:
        return "there is no such anchor"
    return ""
