"""Make docs/report.png anew: the first section of the demo's report, in a browser.

    python tools/update_pictures.py

Needs the extras [report] and [test], and Chromium.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from sdp_vs_penalty.reports.demo import demo

DOCS = Path(__file__).parents[1] / "docs"


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as started:
        demo(folder)
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 900, "height": 1200})
        page.goto((Path(folder) / "report.html").as_uri())
        page.wait_for_selector("body[data-ready]")
        page.locator("#verdict").screenshot(path=DOCS / "report.png")
        browser.close()


if __name__ == "__main__":
    main()
