"""Twelve spoiled logs, from drop to a good model by the one button that is the next step;
and what was done is there after everything that a browser or a server may do."""

import page_driver as driver
import pytest
from page_driver import expect, go, idle, key, open_page
from spoiled_logs import KINDS, write_logs

from sdp_vs_penalty.page.stages import STAGES

#: Steps from dropped runs to a model that needs none: repair, identify, diagnose, add,
#: diagnose again.
MOST_STEPS = 9
LAST = "Download the report"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with driver.serving(tmp_path_factory.mktemp("page")) as made:
        yield made


@pytest.fixture(scope="module")
def browser():
    with driver.browsing() as made:
        yield made


@pytest.fixture
def context(browser):
    with driver.a_context(browser, viewport={"width": 1440, "height": 900}) as made:
        yield made


def drop(page, urdf, runs):
    """Drop a robot and its runs."""
    page.set_input_files(key("drop-robot"), str(urdf))
    page.wait_for_selector(key("drop-runs"), state="attached")
    idle(page)
    page.set_input_files(key("drop-runs"), [str(path) for path in runs])
    page.wait_for_function(
        # None stands there while a repair is tried.
        "!/^$|Choose/.test(document.querySelector('[data-key=next]')?.innerText ?? '')"
    )
    idle(page)


def follow(page):
    """Press the next step until it is the last one; return the verdict."""
    for _ in range(MOST_STEPS):
        label = page.locator(key("next")).inner_text()
        if label == LAST:
            break
        page.click(key("next"))
        if label.startswith("Say the unit"):  # which nobody knows here
            page.click("[data-key$=as-is]")
        page.wait_for_timeout(200)
        idle(page)
        expect(page.locator(key("next"))).not_to_have_text(label)
    return page.locator(".now-words").inner_text()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_spoiled_log_becomes_a_good_model_by_mouse_alone(
    context, server, tmp_path, kind
):
    page = open_page(context, server)
    drop(page, *write_logs(kind, tmp_path))
    assert follow(page).startswith("Good.")


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
def test_the_next_step_is_above_the_fold_of_every_stage(
    browser, server, tmp_path, size
):
    width, height = size
    viewport = {"width": width, "height": height}
    with driver.a_context(browser, viewport=viewport) as context:
        page = open_page(context, server)
        drop(page, *write_logs("sign", tmp_path))
        for stage in STAGES:
            go(page, stage.anchor)
            box = page.locator(key("next")).bounding_box()
            assert box is not None
            assert 0 <= box["y"] < box["y"] + box["height"] <= height
            page.mouse.wheel(0, 3000)
            expect(page.locator(".now-words")).to_be_in_viewport()
            assert page.locator(".action.primary:visible").count() == 1
        assert driver.barriers(page) == []


@pytest.mark.slow
def test_no_work_is_lost(browser, tmp_path):
    """A quick choice of columns, a reload in a job, a closed browser, a server that is
    killed and started again."""
    urdf, runs = write_logs("headerless", tmp_path)
    folder = tmp_path / "page"
    folder.mkdir()
    first = driver.started(folder)
    with driver.a_context(browser) as context:
        page = open_page(context, first)
        drop(page, urdf, runs)
        page.click(key("columns-0"))  # the arm has told them: the form is folded
        for name, column in (("q1", "#3"), ("q2", "#2"), ("q1", "#2"), ("q2", "#3")):
            page.select_option(
                f'[data-key="map-0-{name}"]', column
            )  # as fast as it goes
        page.reload()
        page.click(key("columns-0"))
        for name, column in (("q1", "#2"), ("q2", "#3")):
            box = page.locator(f'[data-key="map-0-{name}"]')
            expect(box).to_have_value(column)
        page.click(key("read-mapped-0"))
        page.wait_for_timeout(200)
        idle(page)
        page.click(key("next"))  # identify
        page.wait_for_selector(".working:not(.hidden)")
        address = page.url.partition("#")[0]
        page.reload()
        page.wait_for_selector("table.history", state="attached")
        idle(page)
        first.process.kill()
        page.wait_for_selector(".lost")
        page.click(key("again"))
        expect(page.locator(".lost p")).to_contain_text("does not run")
        second = driver.started(folder, "--port", str(first.port))
        page.click(key("again"))
        page.wait_for_selector("table.history", state="attached")
        assert page.url.partition("#")[0] == address
    with driver.a_context(browser) as context:  # another day
        page = open_page(context, second, "new")
        page.click("ul.projects a")
        page.wait_for_selector("table.history", state="attached")
        assert page.url.partition("#")[0] == address
    second.process.terminate()
    second.process.wait(30)
