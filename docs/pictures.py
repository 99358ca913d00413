"""The docs' pictures of page and report, made again: python docs/pictures.py (some
minutes)."""

import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "helpers"))

import page_driver as driver  # noqa: E402  (of the tests)

from sdp_vs_penalty.reports.demo import demo  # noqa: E402

#: Of each screen, and of the report, width and height [px].
SIZES = {
    "check": (1100, 760),
    "identify": (1100, 1150),
    "diagnose": (1100, 900),
    "report": (862, 766),
}


def keep(page: Any, name: str) -> None:
    """The top of what is shown, in 64 colours."""
    width, height = SIZES[name]
    page.set_viewport_size({"width": width, "height": height})
    page.wait_for_timeout(3000)  # charts and arm find their size
    out = HERE / (f"{name}.png" if name == "report" else f"page-{name}.png")
    page.screenshot(path=out)
    Image.open(out).convert("RGB").quantize(64).save(out, optimize=True)


folder = tempfile.mkdtemp()
demo(folder)
server = driver.started(Path(tempfile.mkdtemp()))
with server.process, driver.browsing() as browser, driver.a_context(browser) as context:
    page = driver.open_page(context, server)
    page.click(driver.key("show-me"))
    page.wait_for_selector("table.history", state="attached")
    driver.idle(page)
    for stage in ("check", "identify", "diagnose"):
        driver.go(page, stage)
        keep(page, stage)
    report = context.new_page()
    report.goto((Path(folder) / "report.html").as_uri())
    report.wait_for_selector("body[data-ready]")
    keep(report, "report")
    server.process.terminate()
