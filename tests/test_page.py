"""The workbench as a person uses it: the real verb, a real browser."""

from __future__ import annotations

import http.client
import json
import os
import pickle
import re
import shutil
import socket
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from sdp_vs_penalty.comparison import compare
from sdp_vs_penalty.estimate import load_estimate
from sdp_vs_penalty.formats.table import write_npz
from sdp_vs_penalty.hidden_runs import HiddenRuns, hidden_runs
from sdp_vs_penalty.measurements import load_measurements, save_csv
from sdp_vs_penalty.problem import Problem
from sdp_vs_penalty.urdf import load_urdf

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

pytest.importorskip("nicegui", reason="the page needs the extra [page]")
psutil = pytest.importorskip("psutil", reason="it counts the processes: install the extra [test]")
playwright = pytest.importorskip("playwright.sync_api", reason="install the extra [test]")
expect = playwright.expect
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")

DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
ROOT = str(Path(__file__).parents[1])
#: Milliseconds that a job may take on a busy computer.
PATIENCE = 60_000
ARM = """<robot name="arm"><link name="base"/><link name="column"/><link name="slider"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="column"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/></joint>
  <joint name="slide" type="prismatic"><parent link="column"/><child link="slider"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="1" effort="100"/></joint></robot>"""


@dataclass
class Server:
    process: subprocess.Popen[str]
    port: int
    temporary: Path

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def workers(self) -> list[psutil.Process]:
        """Processes that do a job: each leads a group of its own; the next one only waits."""
        found = []
        for p in psutil.Process(self.process.pid).children(recursive=True):
            try:
                if os.getpgid(p.pid) == p.pid and p.status() != psutil.STATUS_ZOMBIE:
                    found.append(p)
            except (psutil.NoSuchProcess, ProcessLookupError):
                continue
        return found


def start(temporary: Path, *arguments: str) -> Server:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    code = "from sdp_vs_penalty.cli import main; main()"
    command = [sys.executable, "-c", code, "page", "--no-browser", "--port", str(port), *arguments]
    environment = {
        **os.environ,
        "TMPDIR": str(temporary),
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([ROOT, os.environ.get("PYTHONPATH", "")]),
    }
    process = subprocess.Popen(
        command, cwd=temporary, env=environment, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert f"http://127.0.0.1:{port}/" in process.stdout.readline()
    return Server(process, port, temporary)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """The verb; at the end it leaves neither processes nor files behind."""
    made = start(tmp_path_factory.mktemp("page"))
    yield made
    family = psutil.Process(made.process.pid).children(recursive=True)
    made.process.terminate()
    made.process.wait(10)
    _, alive = psutil.wait_procs(family, 5)
    assert not alive
    assert list(made.temporary.glob("sdp-vs-penalty-page-*")) == []


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with playwright.sync_playwright() as started:
        made = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture(scope="module")
def hidden(two_link: Problem) -> HiddenRuns:
    return hidden_runs(two_link, [("presliding_hysteresis", [0])], "strong", seed=24)


@pytest.fixture(scope="module")
def files(hidden: HiddenRuns, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three runs and a test run, in two formats."""
    out = tmp_path_factory.mktemp("runs")
    paths = [out / "run1.csv", out / "run2.npz", out / "run3.npz", out / "test.npz"]
    save_csv(hidden.runs[0], paths[0])
    for run, path in zip(hidden.runs[1:], paths[1:], strict=True):
        write_npz(run, path)
    return paths


def key(name: str) -> str:
    return f'[data-key="{name}"]'


def open_page(context: BrowserContext, server: Server, path: str = "new") -> Page:
    """A page whose faults fail the test, and whose every request stays on this computer."""
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    faults: list[str] = []
    page.on("pageerror", lambda e: faults.append(str(e)))
    page.on("request", lambda r: asked(r.url))
    page.on("websocket", lambda w: asked(w.url))

    def asked(url: str) -> None:
        if not re.match(rf"(http|ws)://127\.0\.0\.1:{server.port}/|data:|blob:", url):
            faults.append(f"asked {url}")

    page.faults = faults  # type: ignore[attr-defined]
    page.goto(server.address + path)
    page.wait_for_selector(key("robot-two_link"))
    return page


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    made = browser.new_context(viewport=DESKTOP, reduced_motion="reduce", accept_downloads=True)
    yield made
    faults = [fault for page in made.pages for fault in getattr(page, "faults", [])]
    made.close()
    assert faults == []


def idle(page: Page) -> None:
    expect(page.locator(".working")).to_be_hidden(timeout=PATIENCE)


def alert(page: Page) -> str:
    page.wait_for_selector(".notice[role=alert] p")
    return page.inner_text(".notice[role=alert] .texts")


def busy(server: Server) -> list[Any]:
    """The processes that compute, once there are any."""
    end = time.monotonic() + 10.0
    while time.monotonic() < end:
        if working := [p for p in server.workers() if p.cpu_times().user > 0.3]:
            return working
        time.sleep(0.05)
    raise AssertionError("nothing computes")


def choose(page: Page, robot: str, data: list[Path]) -> None:
    page.click(key(f"robot-{robot}"))
    page.wait_for_selector(key("drop-runs"))
    page.set_input_files(key("drop-runs"), [str(path) for path in data])
    page.wait_for_selector(f"table.runs tbody tr:nth-child({len(data)})")
    idle(page)


def errors(page: Page) -> list[list[float]]:
    """RMS errors of the ladder's table: a list a joint, of its models."""
    rows = page.locator("table.ladder tbody tr").all()
    return [[float(cell) for cell in row.locator("td").all_inner_texts()[:-2]] for row in rows]


def no_sideways_scrolling(page: Page) -> None:
    inside, width = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    assert inside <= width


@pytest.fixture(scope="module")
def story(
    browser: Browser, server: Server, files: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, Any]]:
    """From dropping files to a fallen error and the files to take away, once; tests look at it."""
    context = browser.new_context(viewport=DESKTOP, reduced_motion="reduce", accept_downloads=True)
    page = open_page(context, server)
    seen: dict[str, Any] = {"page": page, "context": context}
    choose(page, "two_link", files)
    seen["uses"] = page.locator("table.runs select").evaluate_all("all => all.map(s => s.value)")
    page.click(key("identify"))
    page.wait_for_selector("[data-step=fit] .js-line")
    seen["fit"] = page.inner_text("[data-step=fit]")
    begin = time.perf_counter()
    page.click(key("joint-2"))
    page.wait_for_function(
        "document.querySelector('[data-step=fit] .ytitle')?.textContent.startsWith('joint 2')"
    )
    seen["click"] = time.perf_counter() - begin
    page.click(key("diagnose"))
    page.wait_for_selector(key("add-0"))
    seen["findings"] = page.inner_text("[data-step=findings]")
    page.click(key("add-0"))
    page.wait_for_selector("table.ladder")
    idle(page)
    seen["errors"] = errors(page)
    page.click(key("compare"))
    page.wait_for_selector("table.methods")
    seen["methods"] = page.locator("table.methods tbody tr").all_inner_texts()
    folder = tmp_path_factory.mktemp("taken")
    for name in ("model.json", "robot.urdf", "robot.xml", "model.py", "report.html"):
        with page.expect_download() as waiting:
            page.click(key(f"take-{name}"))
        assert waiting.value.suggested_filename == name
        waiting.value.save_as(folder / name)
        idle(page)
    seen["folder"] = folder
    yield seen
    context.close()
    assert page.faults == []  # type: ignore[attr-defined]


def test_dropped_files_become_runs(story: dict[str, Any]) -> None:
    assert story["uses"] == ["train", "train", "train", "test"]


def test_what_is_shown_of_the_fit(story: dict[str, Any]) -> None:
    text = story["fit"]
    for words in ("Joint 1", "N m", "noise", "test.npz", "all hold", "Where it fails", "velocity"):
        assert words in text
    assert story["click"] < 2.0  # 0.3 s where nothing else runs


def test_the_hidden_effect_is_named_and_explained(story: dict[str, Any]) -> None:
    text = story["findings"]
    for words in ("Presliding hysteresis · joint 1", "confident", "N m; d = 0.00", "rad", "asperities"):
        assert words in text
    assert "Held-out error of joint 1" in text


def test_the_error_fell_by_what_the_page_says(
    story: dict[str, Any], hidden: HiddenRuns, files: list[Path]
) -> None:
    before, after = story["errors"][0]
    assert after < 0.6 * before
    model = load_estimate(story["folder"] / "model.json")
    mine = compare(model, load_measurements(files[3]))[0].rmse
    assert [row[1] for row in story["errors"]] == pytest.approx(mine.tolist(), rel=6e-3)
    assert model.model.effects[-1].name == "presliding_hysteresis"


def test_methods_stand_side_by_side(story: dict[str, Any]) -> None:
    rows = {row.split("\t")[0]: row.split("\t") for row in story["methods"]}
    assert set(rows) == {"lmi-sdp", "ols", "penalty"}
    assert rows["lmi-sdp"][2] in ("all hold", "all convex ones hold")
    assert rows["ols"][2].startswith("violated by")
    assert all(re.fullmatch(r"[0-9.]+ %", row[1]) for row in rows.values())


def test_what_is_taken_away_works(story: dict[str, Any]) -> None:
    folder = story["folder"]
    robot, links = load_urdf(folder / "robot.urdf", (0.0, 0.0, -9.81))
    assert robot.n == 2
    model = load_estimate(folder / "model.json")
    states = np.random.default_rng(0).uniform(-2.0, 2.0, (3, 50, 2))
    wanted = model.robot.inverse_dynamics(model.links.ravel(), *states)
    np.testing.assert_allclose(robot.inverse_dynamics(links.ravel(), *states), wanted, atol=1e-9)
    assert "<mujoco" in (folder / "robot.xml").read_text()
    compile((folder / "model.py").read_text(), "model.py", "exec")
    html = (folder / "report.html").read_text()
    assert "default-src 'none'" in html
    assert "presliding_hysteresis" in html
    assert not re.search(r"<(script|img|link)[^>]+(src|href)=[\"']?(http|//)", html)


def test_the_state_is_there_after_a_reload_on_a_phone_in_the_dark(
    story: dict[str, Any], browser: Browser, server: Server
) -> None:
    context = browser.new_context(
        viewport=PHONE, color_scheme="dark", has_touch=True, reduced_motion="reduce"
    )
    page = open_page(context, server, story["page"].url.removeprefix(server.address))
    page.wait_for_selector("[data-step=ladder] .js-line, [data-step=ladder] .lines path")
    assert errors(page) == story["errors"]
    no_sideways_scrolling(page)
    for step in ("runs", "model", "fit", "findings", "ladder", "methods", "take-away"):
        page.evaluate(f"workbench.show('{step}')")
        no_sideways_scrolling(page)

    def brightness(what: str, style: str) -> float:
        colour = page.evaluate(f"getComputedStyle(document.querySelector('{what}')).{style}")
        return sum(map(float, re.findall(r"[0-9.]+", colour)[:3])) / 3.0

    def looks_dark() -> bool:
        paper = brightness("body", "backgroundColor")
        ink = brightness("[data-step=fit] .ytitle", "fill")
        assert abs(paper - ink) > 120  # can be read either way, charts too
        return paper < ink

    assert looks_dark()
    page.click(key("theme"))  # dark whatever the system says
    assert looks_dark()
    page.click(key("theme"))
    page.wait_for_function("document.body.classList.contains('body--light')")
    assert not looks_dark()
    context.close()
    assert page.faults == []  # type: ignore[attr-defined]


def test_a_model_can_be_brought(
    story: dict[str, Any], context: BrowserContext, server: Server, files: list[Path]
) -> None:
    """Nothing more is missing of the model that was taken away; another robot's is refused."""
    page = open_page(context, server)
    choose(page, "two_link", files)
    page.click(key("open-model"))
    page.set_input_files(key("drop-model"), str(story["folder"] / "model.json"))
    page.wait_for_selector(key("diagnose"))
    idle(page)
    assert "model.json" in page.inner_text("[data-step=ladder]")
    page.click(key("diagnose"))
    page.wait_for_selector(".verdict")
    assert "Nothing is missing that these measurements could show." in page.inner_text(".verdict")
    text = (story["folder"] / "model.json").read_text().replace('"format": 1', '"format": 99')
    idle(page)
    page.set_input_files(
        key("drop-model"), {"name": "new.json", "mimeType": "text/json", "buffer": text.encode()}
    )
    assert alert(page).startswith("new.json: written by a newer version")


def test_undo_takes_the_last_step_back(story: dict[str, Any], browser: Browser, server: Server) -> None:
    """In a second tab on the same session: both show it."""
    page = open_page(story["context"], server, story["page"].url.removeprefix(server.address))
    page.wait_for_selector(key("undo")).click()
    page.wait_for_selector(key("undo"), state="detached")
    page.wait_for_selector(key("add-0"))
    story["page"].wait_for_selector(key("undo"), state="detached")
    page.click(key("add-0"))
    page.wait_for_selector(key("undo"))
    idle(page)
    assert errors(page) == story["errors"]
    page.close()


def test_with_the_keyboard_alone(context: BrowserContext, server: Server, files: list[Path]) -> None:
    page = open_page(context, server)
    choosers: list[Any] = []
    page.on("filechooser", lambda chooser: choosers.append(chooser))

    def walk(to: str) -> None:
        """Tab until the control has the focus, which can be seen."""
        for _ in range(120):
            page.keyboard.press("Tab")
            found = page.evaluate("document.activeElement?.dataset?.key ?? null")
            if found == to:
                outline = page.evaluate(
                    "getComputedStyle(document.activeElement.closest('.drop, :focus:not([type=file])'))"
                    ".outlineStyle"
                )
                assert outline == "solid"
                return
        raise AssertionError(f"{to} cannot be reached")

    page.keyboard.press("Tab")
    page.keyboard.press("Enter")  # past the header
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.key") == "robot-emps"
    walk("robot-two_link")
    page.keyboard.press("Enter")
    page.wait_for_selector(key("drop-runs"))
    walk("drop-runs")
    page.keyboard.press("Enter")
    for _ in range(100):
        page.wait_for_timeout(100)
        if choosers:
            break
    choosers[0].set_files([str(files[0]), str(files[1]), str(files[3])])
    page.wait_for_selector(key("identify"))
    idle(page)
    walk("identify")
    page.keyboard.press("Space")
    page.wait_for_selector("[data-step=fit] .js-line")
    idle(page)
    expect(page.locator("[aria-live=polite]")).to_have_text("Identifying by lmi-sdp. Done.")
    # The focus is where it was, so that the way goes on from there.
    assert page.evaluate("document.activeElement.dataset.key") == "identify"
    walk("joint-2")
    page.keyboard.press("Enter")
    expect(page.locator(key("joint-2"))).to_have_attribute("aria-pressed", "true")
    walk("diagnose")
    page.keyboard.press("Enter")
    page.wait_for_selector(key("add-0"))
    idle(page)
    walk("add-0")
    page.keyboard.press("Enter")
    page.wait_for_selector("table.ladder")
    idle(page)
    before, after = errors(page)[0]
    assert after < 0.6 * before
    walk("undo")
    page.keyboard.press("Space")
    page.wait_for_selector(key("undo"), state="detached")
    page.click(key("nav-5"))
    assert page.evaluate("document.activeElement.innerText") == "What is missing"


def test_cancel_ends_the_work_within_a_second(context: BrowserContext, server: Server) -> None:
    page = open_page(context, server)
    page.click(key("robot-panda"))
    page.wait_for_selector(key("simulate"))
    idle(page)
    page.click(key("simulate"))
    page.wait_for_selector(".working .status:has-text('simulating')")
    workers = server.workers()
    assert workers
    begin = time.perf_counter()
    page.click(key("cancel"))
    page.wait_for_selector(".notice[role=status] p:has-text('Cancelled: nothing was changed.')")
    assert time.perf_counter() - begin < 1.0
    psutil.wait_procs(workers, 1.0)
    assert page.locator("table.runs").count() == 0
    page.click(key("simulate"))  # and it goes on
    page.wait_for_selector(key("identify"))


def test_a_closed_tab_leaves_nothing_running_and_is_found_again(
    context: BrowserContext, server: Server
) -> None:
    page = open_page(context, server)
    address = page.url
    page.click(key("robot-panda"))
    page.wait_for_selector(key("simulate"))
    idle(page)
    page.click(key("simulate"))
    page.wait_for_selector(key("identify"))
    idle(page)
    page.click(key("identify"))
    page.wait_for_selector(key("compare"))
    idle(page)
    for name in ("lmi-sdp", "ols", "penalty"):
        page.uncheck(key(f"method-{name}"))
    page.check(key("method-penalty-paper"))  # simulated annealing: it takes long
    page.click(key("compare"))
    page.wait_for_selector(".working .status:has-text('penalty-paper')")
    working = busy(server)
    page.close()
    _, alive = psutil.wait_procs(working, 8.0)
    assert not alive
    again = open_page(context, server, "")
    assert again.url == address
    again.wait_for_selector("[data-step=fit] .js-line")
    assert again.locator("table.runs tbody tr").count() == 4
    assert again.locator("table.methods").count() == 0
    again.click(key("diagnose"))  # and it goes on
    again.wait_for_selector(key("add-0"))


def test_two_tabs_are_independent(context: BrowserContext, server: Server) -> None:
    first, second = open_page(context, server), open_page(context, server, "")
    assert first.url != second.url
    first.click(key("robot-panda"))
    second.click(key("robot-emps"))
    for page in (first, second):
        page.wait_for_selector(key("simulate"))
        page.click(key("simulate"))
    for page, joints in ((first, 7), (second, 1)):
        page.wait_for_selector(key("identify"))
        assert page.locator(f"{key('hide-joint')} option").count() == joints
    assert "torques in N." in second.inner_text("[data-step=robot]")
    assert "torques in N m." in first.inner_text("[data-step=robot]")


def bad_runs(folder: Path) -> dict[str, tuple[Path, str]]:
    """Files that nobody can use, with what must be said of them."""

    class Evil:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(folder / "unpickled"),)

    (folder / "binary.csv").write_bytes(bytes(range(256)) * 64)
    (folder / "words.csv").write_text("t,q1,q2,tau1,tau2\n0,a,b,c,d\n")
    (folder / "seven.csv").write_text("t,q1,tau1\n0,0,0\n1,0,0\n")
    # Two members that unpack to 4 GiB each, by the archive's directory; one whose array says 5.6 GB.
    np.savez_compressed(folder / "bomb.npz", t=np.zeros(2**17), q=np.zeros(2**17))
    bomb = bytearray((folder / "bomb.npz").read_bytes())
    for entry in re.finditer(b"PK\x01\x02", bytes(bomb)):
        bomb[entry.start() + 24 : entry.start() + 28] = b"\xf0\xff\xff\xff"
    (folder / "bomb.npz").write_bytes(bomb)
    with zipfile.ZipFile(folder / "claims.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (700000000,), }".ljust(117) + b"\n"
        start = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head
        archive.writestr("t.npy", start + bytes(2**24))
    np.savez(folder / "pickle.npz", t=np.array([Evil()], dtype=object))
    (folder / "run.pkl").write_bytes(pickle.dumps(Evil()))
    return {
        "binary.csv": (folder / "binary.csv", "binary"),
        "words.csv": (folder / "words.csv", "not a number"),
        "seven.csv": (folder / "seven.csv", "the robot has 2"),
        "bomb.npz": (folder / "bomb.npz", "bomb.npz: unpacks to 8 GiB"),
        "claims.npz": (folder / "claims.npz", "claims.npz: not a readable .npz"),
        "pickle.npz": (folder / "pickle.npz", "pickle.npz: not a readable .npz"),
        "run.pkl": (folder / "run.pkl", "files of this kind are not read"),
    }


def test_bad_files_are_refused_in_a_sentence(
    context: BrowserContext, server: Server, files: list[Path], tmp_path: Path
) -> None:
    page = open_page(context, server)
    page.click(key("robot-two_link"))
    page.wait_for_selector(key("drop-runs"))
    for name, (path, words) in bad_runs(tmp_path).items():
        idle(page)
        page.set_input_files(key("drop-runs"), str(path))
        text = alert(page)
        assert words in text, text
        assert name in text
        assert str(server.temporary) not in text
        assert "Traceback" not in text
        idle(page)
        page.click(key("close-notice"))
        page.wait_for_selector(".notice[role=alert] p", state="detached")
    assert not (tmp_path / "unpickled").exists()
    with (tmp_path / "huge.csv").open("wb") as huge:
        huge.truncate(2**30)
    page.set_input_files(key("drop-runs"), str(tmp_path / "huge.csv"))
    assert "huge.csv: 1024 MB; the page takes files up to 256 MB" in alert(page)
    page.set_input_files(key("drop-runs"), str(files[1]))  # and it goes on
    page.wait_for_selector(key("identify"))


def test_bad_robots_are_refused_and_names_are_no_paths(context: BrowserContext, server: Server) -> None:
    page = open_page(context, server)
    entity = '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]><robot name="r">&x;</robot>'
    laughs = '<!DOCTYPE r [<!ENTITY a "ha">' + "".join(
        f'<!ENTITY {b} "{"&" + a + ";" * 1}{("&" + a + ";") * 9}">'
        for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    )
    laughs += ']><robot name="&i;"><link name="base"/></robot>'
    secret = Path("/etc/hostname").read_text().strip() if Path("/etc/hostname").exists() else "?"
    for name, content in (
        ("entity.urdf", entity),
        ("laughs.urdf", laughs),
        ("../../<img src=x onerror=alert(1)>.urdf", "<robot"),
        ("C:\\Users\\me\\broken.urdf", "<sdf/>"),
    ):
        idle(page)
        begin = time.perf_counter()
        page.set_input_files(
            key("drop-robot"), {"name": name, "mimeType": "text/xml", "buffer": content.encode()}
        )
        text = alert(page)
        assert time.perf_counter() - begin < 10.0
        assert ".urdf: " in text
        assert "/" not in text.split(":")[0]
        assert "\\" not in text.split(":")[0]
        assert len(secret) < 4 or secret not in text
        idle(page)
        page.click(key("close-notice"))
        page.wait_for_selector(".notice[role=alert] p", state="detached")
    assert page.locator("img").count() == 0  # a name is text
    arm = {"name": "../my arm.urdf", "mimeType": "text/xml", "buffer": ARM.encode()}
    page.set_input_files(key("drop-robot"), arm)
    page.wait_for_selector(key("drop-runs"))
    text = page.inner_text("[data-step=robot]")
    assert "my arm.urdf: arm, 2 joint(s)" in text
    assert "turn [N m], slide [N]" in text
    # Whatever the names said, files are in the session's own folder under names of ours.
    (root,) = server.temporary.glob("sdp-vs-penalty-page-*")
    kept = [p for p in root.rglob("*") if p.is_file()]
    assert any(re.fullmatch(r"file-[0-9a-f]{16}\.urdf", p.name) for p in kept)
    assert not [p for p in server.temporary.rglob("*.urdf") if p not in kept]


def test_files_can_be_dragged_onto_the_page(
    context: BrowserContext, server: Server, two_link: Problem
) -> None:
    page = open_page(context, server)
    drop = page.evaluate_handle(
        "text => { const d = new DataTransfer();"
        " d.items.add(new File([text], 'arm.urdf', {type: 'text/xml'})); return d; }",
        ARM,
    )
    page.dispatch_event('[data-drop="robot"]', "drop", {"dataTransfer": drop})
    page.wait_for_selector(".chosen:has-text('arm.urdf')")


def test_other_sites_and_names_get_nothing(server: Server) -> None:
    def status(method: str, path: str, headers: dict[str, str]) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        answer.read()
        connection.close()
        return answer.status

    own = {"Host": f"127.0.0.1:{server.port}"}
    assert status("GET", "/new", own) == 303
    assert status("GET", "/new", {"Host": "evil.example"}) == 403
    assert status("GET", "/new", {**own, "Origin": "http://evil.example"}) == 403
    upgrade = {
        "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }  # fmt: skip
    socket_path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    assert status("GET", socket_path, {**own, **upgrade, "Origin": "http://evil.example"}) == 403
    for path in ("/s/guess/take/model.json", "/s/guess/take/..%2f..%2fetc%2fpasswd"):
        assert status("GET", path, own) == 404
    assert status("PUT", "/s/guess/files?name=a.csv&kind=runs", own) == 404


def test_the_folder_is_offered_and_kept_as_it_is(
    browser: Browser, files: list[Path], tmp_path: Path
) -> None:
    folder, temporary = tmp_path / "mine", tmp_path / "tmp"
    folder.mkdir()
    temporary.mkdir()
    for path in files:
        shutil.copy(path, folder)
    (folder / "arm.urdf").write_text(ARM)
    (folder / "elsewhere.csv").symlink_to("/etc/hosts")
    before = {p: p.lstat().st_mtime_ns for p in folder.iterdir()}
    server = start(temporary, str(folder))
    try:
        context = browser.new_context(viewport=DESKTOP)
        page = open_page(context, server)
        assert "arm.urdf" in page.inner_text("[data-step=robot]")
        page.click(key("robot-two_link"))
        page.wait_for_selector(key("read-folder"))
        assert "elsewhere.csv" not in page.inner_text("[data-step=runs]")
        page.get_by_label("run1.csv").check()
        page.get_by_label("test.npz").check()
        page.click(key("read-folder"))
        page.wait_for_selector("table.runs tbody tr:nth-child(2)")
        context.close()
    finally:
        server.process.terminate()
        server.process.wait(10)
    assert before == {p: p.lstat().st_mtime_ns for p in folder.iterdir()}


def test_a_taken_port_is_said(server: Server) -> None:
    code = "from sdp_vs_penalty.cli import main; main()"
    command = [sys.executable, "-c", code, "page", "--no-browser", "--port", str(server.port)]
    environment = {**os.environ, "PYTHONPATH": ROOT}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment)
    assert done.returncode == 2
    assert f"--port {server.port}: is taken: choose another" in done.stderr
    assert json.dumps(done.stderr).count("\\n") == 1
