"""The page's verb and a browser on it, for the tests that use both."""

import os
import re
import shutil
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from commands import HOME, PROGRAM

pytest.importorskip("nicegui", reason="the page needs the extra [page]")
psutil = pytest.importorskip(
    "psutil", reason="it counts the processes: install the extra [test]"
)
playwright = pytest.importorskip(
    "playwright.sync_api", reason="install the extra [test]"
)
expect = playwright.expect
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("Chromium is not installed (Debian: chromium)", allow_module_level=True)

DESKTOP = {"width": 1280, "height": 800}
PHONE = {"width": 390, "height": 844}
ROOT = str(Path(__file__).parents[2])
#: Milliseconds that a job may take on a busy computer.
PATIENCE = 240_000


@dataclass
class Server:
    process: subprocess.Popen[str]
    port: int
    key: str

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}/"

    def workers(self):
        """Processes that do a job: each leads a group of its own; the next one only
        waits."""
        found = []
        for p in psutil.Process(self.process.pid).children(recursive=True):
            try:
                if os.getpgid(p.pid) == p.pid and p.status() != psutil.STATUS_ZOMBIE:
                    found.append(p)
            except (psutil.NoSuchProcess, ProcessLookupError):
                continue
        return found


def started(folder, *options):
    """The verb, which has said where it is; its files are in the folder."""
    command = [sys.executable, *PROGRAM, "page", "--no-browser", *options]
    kept = {"TMPDIR": str(folder), "SDP_VS_PENALTY_PROJECTS": str(folder / "projects")}
    environment = {**os.environ, **kept, "PYTHONPATH": HOME}
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
    )
    printed = re.search(
        r"http://127\.0\.0\.1:(\d+)/\?key=(\S+)", process.stdout.readline()
    )
    return Server(process, int(printed[1]), printed[2])


@contextmanager
def serving(folder, *options):
    """The page's server, until it is no longer needed."""
    server = started(folder, *options)
    try:
        yield server
    finally:
        server.process.terminate()
        server.process.wait(30)


@contextmanager
def browsing():
    with playwright.sync_playwright() as started:
        made = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield made
        made.close()


@contextmanager
def a_context(browser, **options):
    """A browser of its own, as it were; faults of its pages fail the test."""
    options = {
        "viewport": DESKTOP,
        "reduced_motion": "reduce",
        "accept_downloads": True,
        **options,
    }
    made = browser.new_context(**options)
    yield made
    faults = [fault for page in made.pages for fault in getattr(page, "faults", [])]
    made.close()
    assert not faults, faults


def key(name):
    return f'[data-key="{name}"]'


def open_page(context, server, path="new"):
    """A page whose faults fail the test, and whose every request stays on this
    computer."""
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    faults = []
    page.on("pageerror", lambda e: faults.append(str(e)))
    page.on("request", lambda r: asked(r.url))
    page.on("websocket", lambda w: asked(w.url))

    def asked(url):
        if not re.match(rf"(http|ws)://127\.0\.0\.1:{server.port}/|data:|blob:", url):
            faults.append(f"asked {url}")

    page.faults = faults
    page.goto(f"{server.address}{path}?key={server.key}")
    # A tab of a session that is there already shows the step that was shown last.
    page.wait_for_selector("[data-part=robot] .body > *", state="attached")
    return page


def idle(page):
    expect(page.locator(".working")).to_be_hidden(timeout=PATIENCE)


def act(page, control, shown):
    """Press a control, and wait until what it makes is shown and its job is done."""
    page.click(key(control))
    page.wait_for_selector(shown)
    idle(page)


def go(page, stage):
    """To a stage by the rail."""
    page.click(f"nav.stages [data-to={stage}]")


def pick(page, robot):
    """A built-in robot."""
    page.click(key(f"robot-{robot}"))
    page.wait_for_selector(key("drop-runs"), state="attached")


def choose(page, robot, data):
    """A robot and files with its runs, and on to Identify."""
    pick(page, robot)
    page.set_input_files(key("drop-runs"), [str(path) for path in data])
    page.wait_for_selector(f"table.runs tbody tr:nth-child({len(data)})")
    idle(page)
    go(page, "identify")


def errors(page):
    """RMS errors of the history's table, once it is there: a list a joint, of its
    models."""
    page.wait_for_selector("[data-part=history] table.history", state="attached")
    rows = page.locator("[data-part=history] table.history tbody tr").all()
    heads = page.locator(
        "[data-part=history] table.history thead th"
    ).all_text_contents()
    n = sum(bool(re.fullmatch(r"error \d+", head)) for head in heads)
    return [list(map(float, row.locator("td").all_text_contents()[:n])) for row in rows]


def barriers(page):
    """What axe-core calls a serious or critical fault of accessibility on what is shown
    now."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [
        f"{v['id']}: {v['nodes'][0]['html'][:200]}"
        for v in found
        if v["impact"] in ("serious", "critical")
    ]


def no_sideways_scrolling(page):
    """Once what was drawn out of sight has found its width."""
    page.wait_for_function(
        "document.documentElement.scrollWidth <= window.innerWidth", timeout=5000
    )
