"""Every link of the built site leads somewhere on it, and nothing is loaded from elsewhere."""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlsplit


class _Page(HTMLParser):
    """The anchors of a page, what it links to and what it loads."""

    def __init__(self, text: str):
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        held = {key: value or "" for key, value in attrs}
        self.anchors |= {held[key] for key in ("id", "name") if key in held}
        if "href" in held and tag != "link":
            self.links.append(held["href"])
        elif "href" in held and held.get("rel") not in ("canonical", "next", "prev"):
            self.loaded.append(held["href"])
        if "src" in held:
            self.loaded.append(held["src"])


def broken_links(site: Path) -> list[str]:
    """Links and loads that lead nowhere, or outside where nothing may; a line for each."""
    pages = {
        path.resolve(): _Page(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))
    }
    return [
        f"{path.relative_to(site.resolve())}: {problem}"
        for path, page in pages.items()
        if path.name != "404.html"  # it is shown at any address, and its links count from the root
        for problem in _problems(path, page, pages)
    ]


def _problems(path: Path, page: _Page, pages: dict[Path, _Page]) -> Iterator[str]:
    for address in page.loaded:
        if _is_elsewhere(address):
            yield f"loads {address}"
    inside = (a for a in (*page.links, *page.loaded) if not any(urlsplit(a)[:2]))
    for address in inside:
        place, anchor = urldefrag(address)
        aim = (path.parent / unquote(place.split("?")[0])).resolve() if place else path
        aim = aim / "index.html" if aim.is_dir() else aim
        if not aim.is_file():
            yield f"links to {address}, which is not there"
        elif anchor and aim in pages and unquote(anchor) not in pages[aim].anchors | {"__skip"}:
            yield f"links to {address}, where there is no such anchor"


def _is_elsewhere(address: str) -> bool:
    scheme, host, *_ = urlsplit(address)
    return bool(host) or scheme not in ("", "data")
