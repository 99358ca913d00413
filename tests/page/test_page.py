"""The workbench as a person uses it: the real verb, a real browser, the whole story."""

import base64
import gzip
import http.client
import re
import socket
from pathlib import Path

import numpy as np
import page_driver as driver
import pytest
from commands import run_cli
from page_driver import act, expect, go, idle, key, open_page
from scipy.signal import savgol_filter
from spoiled_logs import write_logs

from sdp_vs_penalty import compare, load_estimate, load_measurements
from sdp_vs_penalty.data import save
from sdp_vs_penalty.page.stages import STAGES
from sdp_vs_penalty.robot import load_urdf


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """The verb; at the end it leaves neither processes nor files behind."""
    temporary = tmp_path_factory.mktemp("page")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    made = driver.started(temporary, "--port", str(port))
    assert made.port == port
    yield made
    family = driver.psutil.Process(made.process.pid).children(recursive=True)
    made.process.terminate()
    made.process.wait(60)
    _, alive = driver.psutil.wait_procs(family, 30)
    assert not alive, alive
    assert list(temporary.glob("sdp-vs-penalty-page-*")) == []
    assert list(temporary.glob("pymp-*")) == []  # Python's own, of its processes


@pytest.fixture(scope="module")
def browser():
    with driver.browsing() as made:
        yield made


@pytest.fixture
def context(browser):
    with driver.a_context(browser) as made:
        yield made


@pytest.fixture(scope="module")
def files(hidden, tmp_path_factory):
    """Two runs with a hidden effect and a shorter test run, in two formats."""
    folder = tmp_path_factory.mktemp("runs")
    seconds = {"run1.csv": 8.0, "run2.npz": 8.0, "test.npz": 4.0}
    paths = [folder / name for name in seconds]
    for run, path in zip(hidden.runs[:3], paths, strict=True):
        save(run.window(0.0, seconds[path.name]), path)
    return paths


@pytest.fixture(scope="module")
def story(browser, server, files, tmp_path_factory):
    """From dropping files to a fallen error and the files to take away, once; tests
    look at it."""
    with driver.a_context(browser) as context:
        page = open_page(context, server)
        seen = {"page": page, "context": context, "barriers": driver.barriers(page)}
        driver.choose(page, "two_link", files)
        act(page, "identify", "[data-part=fit] .js-line")
        page.click(key("joint-2"))
        page.wait_for_function(
            "document.querySelector('[data-part=fit]"
            " .ytitle')?.textContent.startsWith('joint 2')"
        )
        go(page, "diagnose")
        page.click(key("diagnose"))
        pressed = page.locator(f"{key('diagnose')}.running[data-runs]")
        seen["runs"] = pressed.get_attribute("data-runs")
        seen["others"] = page.locator(key("next")).get_attribute("aria-disabled")
        seen["barriers"] += driver.barriers(page)
        page.wait_for_selector(key("add-0"))
        idle(page)
        seen["barriers"] += driver.barriers(page)
        page.click(key("add-0"))
        seen["errors"] = driver.errors(page)
        idle(page)
        go(page, "identify")
        act(page, "compare", "table.methods")
        seen["barriers"] += driver.barriers(page)
        go(page, "use")
        act(page, "forward", "[data-part=forward] table")
        seen["barriers"] += driver.barriers(page)
        folder = tmp_path_factory.mktemp("taken")
        for name in ("model.json", "robot.urdf", "robot.xml", "report.html"):
            with page.expect_download() as waiting:
                page.click(key(f"take-{name}"))
            assert waiting.value.suggested_filename == name
            waiting.value.save_as(folder / name)
            idle(page)
        seen["folder"] = folder
        yield seen


@pytest.mark.long
def test_the_pressed_button_says_what_runs_and_no_other_starts_a_job(story):
    assert story["runs"] == "Looking for what is missing …"
    assert story["others"] == "true"


@pytest.mark.long
def test_the_error_falls_before_ones_eyes(story):
    before, after = story["errors"][0]
    assert after < 0.6 * before


def beside_friction(tau, dq, torque):
    """RMS torque (n,) that an arm's torque, friction and an offset leave of a run."""
    left = tau - torque
    for j, own in enumerate(np.moveaxis([dq, np.sign(dq), np.ones_like(dq)], 2, 0)):
        left[:, j] -= own.T @ np.linalg.lstsq(own.T, left[:, j], rcond=None)[0]
    return np.sqrt(np.mean(left**2, axis=0))


@pytest.mark.long
def test_the_page_is_accessible_and_what_is_taken_away_works(story, files):
    assert story["barriers"] == []
    folder = story["folder"]
    robot, links = load_urdf(folder / "robot.urdf", (0.0, 0.0, -9.81))
    model = load_estimate(folder / "model.json")
    run = load_measurements(files[0])
    # The file cannot hold the effect that was added: its links are identified without.
    q, dq, ddq = (
        savgol_filter(run.q, 41, 4, k, np.diff(run.t)[0], axis=0) for k in range(3)
    )
    in_file, of_model = (
        beside_friction(run.tau, dq, arm.inverse_dynamics(theta.ravel(), q, dq, ddq))
        for arm, theta in ((robot, links), (model.robot, model.links))
    )
    assert np.all(in_file <= of_model)
    assert "<mujoco" in (folder / "robot.xml").read_text()
    address = story["page"].url.partition("#")[0]
    assert story["page"].request.get(f"{address}/take/nothing.json").status == 404
    html = (folder / "report.html").read_text()
    assert compare(model, load_measurements(files[2]))[0].verdict.grade in html.lower()
    assert "default-src 'none'" in html
    assert not re.search(r"<(script|img|link)[^>]+(src|href)=[\"']?(http|//)", html)


@pytest.mark.long
def test_the_report_draws_and_is_accessible(story, browser):
    """Joints are zoomed together, far figures wait, and no script was refused."""
    path = story["folder"] / "report.html"
    script = re.findall(r'id="plotly">(.*?)</script>', path.read_text())[0]
    read = gzip.decompress(base64.b64decode(script))
    assert (
        b"root.moduleName = factory" not in read
    )  # the function that a browser would read twice
    faults = []
    page = browser.new_page(viewport={"width": 1000, "height": 1200})
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on(
        "console",
        lambda said: faults.append(said.text) if said.type == "error" else None,
    )
    page.goto(path.as_uri())
    page.wait_for_function("document.querySelectorAll('#torques .js-line').length >= 8")
    assert page.locator("#provenance").count() == 1
    assert page.locator("#friction .js-plotly-plot").count() == 0
    first, second = (
        f"document.querySelectorAll('#torques .plot')[{k}]" for k in (0, 1)
    )
    page.evaluate(
        f"Plotly.relayout({first}, {{'xaxis.range[0]': 3, 'xaxis.range[1]': 5}})"
    )
    page.wait_for_function(f"{second}.layout.xaxis.range?.[1] === 5")
    assert driver.barriers(page) == []
    page.locator("#torques .legendtoggle").nth(1).click()
    page.wait_for_function(f"{second}.data[1].visible === 'legendonly'")
    page.evaluate("document.querySelector('#friction').scrollIntoView()")
    page.wait_for_selector("#friction .js-plotly-plot")
    page.wait_for_function(
        "document.querySelectorAll('#friction .js-line').length >= 2 * 2"
    )
    page.close()
    assert faults == []


@pytest.mark.long
def test_the_state_is_there_after_a_reload_on_a_phone_in_the_dark(
    story, browser, server
):
    with driver.a_context(
        browser,
        viewport=driver.PHONE,
        color_scheme="dark",
        has_touch=True,
        is_mobile=True,
    ) as context:
        without_stage = story["page"].url.partition("#")[0]
        page = open_page(context, server, without_stage.removeprefix(server.address))
        page.wait_for_selector("table.history", state="attached")
        assert driver.errors(page) == story["errors"]
        driver.no_sideways_scrolling(page)
        for stage in STAGES:
            go(page, stage.anchor)
            driver.no_sideways_scrolling(page)
        go(page, "identify")

        def brightness(what, style):
            colour = page.evaluate(
                f"getComputedStyle(document.querySelector('{what}')).{style}"
            )
            return sum(map(float, re.findall(r"[0-9.]+", colour)[:3])) / 3.0

        paper = brightness("body", "backgroundColor")
        assert (
            brightness("[data-part=fit] .ytitle", "fill") - paper > 120
        )  # charts, too


@pytest.mark.slow
def test_with_the_keyboard_alone(context, server, files):
    """Where the focus is can be seen, and after each step it stands where the way goes
    on."""
    page = open_page(context, server)
    shown = (
        "getComputedStyle(document.activeElement.closest('.drop,"
        " :focus:not([type=file])')).outlineStyle"
    )

    def press(to, what="Enter"):
        """Tab until the control has the focus, and press it."""
        for _ in range(120):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement?.dataset?.key ?? null") == to:
                break
        assert page.evaluate("document.activeElement?.dataset?.key ?? null") == to
        assert page.evaluate(shown) == "solid"
        page.keyboard.press(what)

    page.keyboard.press("Tab")
    page.keyboard.press("Enter")  # past the header
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.key") == "next"
    press("robot-two_link")
    page.wait_for_selector(key("drop-runs"))
    with page.expect_file_chooser() as chooser:
        press("drop-runs")
    chooser.value.set_files([str(files[0]), str(files[1]), str(files[2])])
    page.wait_for_selector("table.runs")
    idle(page)
    expect(page.locator(key("next"))).to_have_text("Identify the model")
    press("next", "Space")
    page.wait_for_selector("[data-part=fit] .js-line")
    idle(page)
    expect(page.locator("[aria-live=polite]")).to_have_text(
        "Identifying the model. Done."
    )
    heading = page.evaluate("document.activeElement.innerText")
    assert heading == "Identify"  # what is new stands first there
    press("joint-2")
    expect(page.locator(key("joint-2"))).to_have_attribute("aria-pressed", "true")


@pytest.mark.long
def test_files_can_be_dragged_onto_the_page(context, server, two_link):
    page = open_page(context, server)
    drop = page.evaluate_handle(
        "text => { const d = new DataTransfer();"
        " d.items.add(new File([text], 'arm.urdf', {type: 'text/xml'})); return d; }",
        (Path(driver.ROOT) / "docs" / "my_arm.urdf").read_text(),
    )
    page.dispatch_event(".drop", "drop", {"dataTransfer": drop})
    page.wait_for_selector(".chosen:has-text('arm.urdf')")


@pytest.mark.long
def test_a_column_is_dragged_to_what_it_is(context, server, tmp_path):
    """By the mouse, from the file's columns to a field of ours; a reload keeps it."""
    urdf, runs = write_logs("headerless", tmp_path)
    page = open_page(context, server)
    page.set_input_files(key("drop-robot"), str(urdf))
    page.wait_for_selector(key("drop-runs"), state="attached")
    idle(page)
    page.set_input_files(key("drop-runs"), [str(runs[0])])
    page.locator(key("columns-0")).wait_for()
    idle(page)
    page.locator(key("columns-0")).click()  # the arm has told them: the form is folded
    page.locator(key("all-columns-0")).click()
    field = page.locator(key("map-0-q1"))
    column = page.locator(".of-file", has_text="#3")
    field.scroll_into_view_if_needed()
    assert field.bounding_box()["width"] > 190.0  # it shows "#3: -1.57 to 1.57"
    expect(field).not_to_have_value("#3")
    column.drag_to(field)
    expect(field).to_have_value("#3")
    page.reload()
    page.locator(key("columns-0")).click()
    expect(page.locator(key("map-0-q1"))).to_have_value("#3")


def test_other_sites_and_names_get_nothing(server):
    def status(method, path, headers):
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        answer.read()
        connection.close()
        return answer.status

    nobody = {"Host": f"127.0.0.1:{server.port}"}
    for path in ("/", "/new", "/s/guess", "/new?key=guess", "/_nicegui/"):
        assert status("GET", path, nobody) == 403
    own = {**nobody, "Cookie": f"sdp-vs-penalty-key-{server.port}={server.key}"}
    assert (
        status("GET", "/new", own)
        == status("GET", f"/new?key={server.key}", nobody)
        == 303
    )
    assert status("POST", f"/s/guess/sent?key={server.key}", nobody) == 403
    assert status("GET", "/new", {**own, "Host": "evil.example"}) == 400
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Origin": "http://evil.example",
    }
    socket_path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    assert status("GET", socket_path, {**own, **upgrade}) == 403
    for path in ("/s/guess/take/model.json", "/s/guess/take/..%2f..%2fetc%2fpasswd"):
        assert status("GET", path, own) == 404
    assert status("PUT", "/s/guess/files?name=a.csv", own) == 404


def test_a_taken_port_is_said(server, monkeypatch, capsys):
    monkeypatch.setattr("uvicorn.Server.run", lambda *_, **__: pytest.fail("served"))
    assert run_cli("page", "--no-browser", "--port", server.port) == 2
    said = capsys.readouterr().err
    assert f"--port {server.port}: is taken: choose another" in said
    assert said.count("\n") == 1
