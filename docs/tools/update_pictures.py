"""Make the pictures of docs/ anew, in a browser: the report's first section, and the
page's screens.

    python docs/tools/update_pictures.py [FOLDER]

Needs the extras [report], [page] and [test], and Chromium.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from page_driver import browsing, go, idle, key, open_page, serving  # noqa: E402
from PIL import Image  # noqa: E402

from sdp_vs_penalty.reports.demo import demo  # noqa: E402

#: Pixels that are kept of each screen, from its top, and the colours of a picture.
_SCREENS = {"check": 760, "identify": 1150, "diagnose": 1150}
_WIDTH = 1100
_COLOURS = 96


def make(folder: Path) -> list[Path]:
    """report.png and page-<stage>.png in a folder."""
    made = []
    with tempfile.TemporaryDirectory() as work, browsing() as browser:
        demo(work)
        page = browser.new_page(viewport={"width": 900, "height": 1200})
        page.goto((Path(work) / "report.html").as_uri())
        page.wait_for_selector("body[data-ready]")
        page.locator("#verdict").screenshot(path=folder / "report.png")
        made.append(_small(folder / "report.png"))
        with serving(Path(work)) as server:
            size = {"width": _WIDTH, "height": 900}
            context = browser.new_context(viewport=size, reduced_motion="reduce")
            page = open_page(context, server)
            page.click(key("show-me"))
            page.wait_for_selector("table.history", state="attached")
            idle(page)
            for stage, height in _SCREENS.items():
                go(page, stage)
                page.wait_for_timeout(3000)  # charts and the arm are drawn
                page.set_viewport_size({"width": _WIDTH, "height": height})
                path = folder / f"page-{stage}.png"
                page.screenshot(path=path)
                made.append(_small(path))
            context.close()
    return made


def _small(path: Path) -> Path:
    """The same picture in fewer colours."""
    Image.open(path).convert("RGB").quantize(_COLOURS).save(path, optimize=True)
    return path


if __name__ == "__main__":
    for path in make(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs"):
        print(path)
