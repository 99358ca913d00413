"""The workbench when things go wrong: cancelled work, closed tabs, bad files, other sites."""

import http.client
import re
import shutil

import pytest
from commands import PROGRAM, python
from page_driver import ARM, a_context, alert, busy, go, idle, key, open_page, pick, psutil, serving

from sdp_vs_penalty.page.sessions import SILENCE


@pytest.mark.slow
def test_a_closed_tab_leaves_nothing_running_and_is_found_again(context, server):
    page = open_page(context, server)
    address = page.url
    pick(page, "panda")
    page.wait_for_selector(key("simulate"))
    idle(page)
    page.click(key("simulate"))
    page.wait_for_selector("table.runs")
    idle(page)
    go(page, "identify")
    page.click(key("identify"))
    page.wait_for_selector("[data-part=fit] .js-line")
    idle(page)
    for name in ("lmi-sdp", "ols", "penalty"):
        page.uncheck(key(f"method-{name}"))
    for name in ("penalty-paper", "penalty-paper-two-step", "penalty-two-step", "lmi-sdp-entropic"):
        page.check(key(f"method-{name}"))  # simulated annealing: together, in folds, they take minutes
    page.check(key("folds"))
    page.click(key("compare"))
    page.wait_for_selector(".working .status:has-text('penalty-paper')")
    working = busy(server)
    page.close()
    _, alive = psutil.wait_procs(working, SILENCE + 8.0)
    assert not alive
    again = open_page(context, server, "")
    assert again.url == address
    again.wait_for_selector("table.runs", state="attached")
    go(again, "identify")
    again.wait_for_selector("[data-part=fit] .js-line")
    assert again.locator("table.runs tbody tr").count() == 4
    assert again.locator("table.methods").count() == 0


@pytest.mark.long
def test_bad_robots_are_refused_and_names_are_no_paths(context, server):
    page = open_page(context, server)
    entity = '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]><robot name="r">&x;</robot>'
    for name, content in (
        ("entity.urdf", entity),
        ("../../<img src=x onerror=alert(1)>.urdf", "<robot"),
    ):
        idle(page)
        page.set_input_files(
            key("drop-robot"), {"name": name, "mimeType": "text/xml", "buffer": content.encode()}
        )
        text = alert(page)
        assert ".urdf: " in text
        assert "/" not in text.split(":")[0]
        idle(page)
        page.click(key("close-notice"))
        page.wait_for_selector(".notice[role=alert] p", state="detached")
    assert page.locator("img").count() == 0  # a name is text
    arm = {"name": "../my arm.urdf", "mimeType": "text/xml", "buffer": ARM.encode()}
    page.set_input_files(key("drop-robot"), arm)
    page.wait_for_selector(key("drop-runs"), state="attached")
    assert "my arm.urdf: arm, 2 joints" in page.inner_text("[data-part=robot]")
    # Whatever the names said, files are in the session's own folder under names of ours.
    (root,) = server.temporary.glob("sdp-vs-penalty-page-*")
    kept = [p for p in root.rglob("*") if p.is_file()]
    assert any(re.fullmatch(r"file-[0-9a-f]{16}\.urdf", p.name) for p in kept)
    assert not [p for p in server.temporary.rglob("*.urdf") if p not in kept]


@pytest.mark.long
def test_files_can_be_dragged_onto_the_page(context, server, two_link):
    page = open_page(context, server)
    drop = page.evaluate_handle(
        "text => { const d = new DataTransfer();"
        " d.items.add(new File([text], 'arm.urdf', {type: 'text/xml'})); return d; }",
        ARM,
    )
    page.dispatch_event('[data-drop="robot"]', "drop", {"dataTransfer": drop})
    page.wait_for_selector(".chosen:has-text('arm.urdf')")


def test_other_sites_and_names_get_nothing(server):
    def status(method: str, path: str, headers: dict[str, str]) -> int:
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
    assert status("GET", "/new", own) == status("GET", f"/new?key={server.key}", nobody) == 303
    assert status("POST", f"/s/guess/sent?key={server.key}", nobody) == 403
    assert status("GET", "/new", {**own, "Host": "evil.example"}) == 400
    upgrade = {
        "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Origin": "http://evil.example",
    }  # fmt: skip
    socket_path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    assert status("GET", socket_path, {**own, **upgrade}) == 403
    for path in ("/s/guess/take/model.json", "/s/guess/take/..%2f..%2fetc%2fpasswd"):
        assert status("GET", path, own) == 404
    assert status("PUT", "/s/guess/files?name=a.csv&kind=runs", own) == 404


@pytest.mark.slow
def test_the_folder_is_offered_and_kept_as_it_is(browser, files, tmp_path):
    folder, temporary = tmp_path / "mine", tmp_path / "tmp"
    folder.mkdir()
    temporary.mkdir()
    for path in files:
        shutil.copy(path, folder)
    (folder / "arm.urdf").write_text(ARM)
    (folder / "elsewhere.csv").symlink_to("/etc/hosts")
    mine = folder / "with_bounds"
    mine.mkdir()
    (mine / "problem.toml").write_text('title = "An arm"\n[kinematics]\nurdf = "../arm.urdf"\n')
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "problem.toml").write_text("")
    (folder / "not_mine").symlink_to(tmp_path / "elsewhere")
    before = {p: p.lstat().st_mtime_ns for p in folder.iterdir()}
    with serving(temporary, str(folder)) as server, a_context(browser) as context:
        page = open_page(context, server)
        offered = page.inner_text("[data-part=robot]")
        assert "arm.urdf" in offered
        assert "not_mine" not in offered
        pick(page, "with_bounds")
        page.wait_for_selector("text=with_bounds has 2 joints")
        page.click(key("another-robot"))
        page.click(key("robot-two_link"))
        page.wait_for_selector("text=two_link has 2 joints")  # the runs of the other one are gone
        page.wait_for_selector(key("read-folder"))
        assert "elsewhere.csv" not in page.inner_text("[data-part=runs]")
        page.get_by_label("run1.csv").check()
        page.get_by_label("test.npz").check()
        page.click(key("read-folder"))
        page.wait_for_selector("table.runs tbody tr:nth-child(2)")
    assert before == {p: p.lstat().st_mtime_ns for p in folder.iterdir()}


def test_a_taken_port_is_said(server):
    done = python(*PROGRAM, "page", "--no-browser", "--port", server.port)
    assert done.returncode == 2
    assert f"--port {server.port}: is taken: choose another" in done.stderr
    assert done.stderr.count("\n") == 1
