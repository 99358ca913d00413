"""Find links of the built site that lead nowhere: files and anchors inside of it.

    mkdocs build --strict --site-dir build/site
    python docs/tools/check_links.py build/site

Exit code 1 where one is dead. Links to other sites are listed, not followed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlparse

#: Attributes that hold a link.
_LINKS = ("href", "src")


@dataclass
class Page(HTMLParser):
    """The anchors and links of one page."""

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what a tag names and where it leads."""
        for name, value in attrs:
            if value and name in _LINKS:
                self.links.append(value)
            elif value and name in ("id", "name"):
                self.anchors.add(value)


def read_pages(site: Path) -> dict[Path, Page]:
    """Read every page of a site, by its resolved path."""
    pages = {}
    for path in sorted(site.rglob("*.html")):
        page = Page()
        page.feed(path.read_text(encoding="utf-8"))
        pages[path.resolve()] = page
    return pages


def is_dead(link: str, path: Path, site: Path, pages: dict[Path, Page]) -> bool:
    """Return whether a link of the page at ``path`` leads nowhere inside the site."""
    url = urlparse(link)
    if url.scheme or url.netloc:
        return False
    target = path
    if url.path:
        folder = site if url.path.startswith("/") else path.parent
        target = (folder / unquote(url.path).lstrip("/")).resolve()
    if target.is_dir():
        target = target / "index.html"
    if not target.exists():
        return True
    anchor = unquote(url.fragment)
    is_page = target in pages
    return bool(anchor) and is_page and anchor not in pages[target].anchors


def main(site: Path) -> int:
    """Print dead links and links to other sites; return the exit code."""
    pages = read_pages(site)
    count = 0
    dead = []
    elsewhere = set()
    for path, page in pages.items():
        for link in page.links:
            if urlparse(link).scheme in ("http", "https"):
                elsewhere.add(link)
                continue
            count += 1
            if is_dead(link, path, site.resolve(), pages):
                dead.append(f"{path.relative_to(site.resolve())}: {link}")
    print(f"{len(pages)} pages, {count} links inside, {len(dead)} dead")
    print(*dead, *(f"elsewhere: {link}" for link in sorted(elsewhere)), sep="\n")
    return 1 if dead else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
