"""How long the page takes, in a real browser.

    python results/page_timings/page_timings.py [--repeats N] [--only WORD ...]
        [--out FOLDER]

Needs the extras [page] and [test] and Chromium. Starts the verb ``page``, opens it and
measures, in seconds of wall time: the first load, a click on a stage, three runs of
3 MB dropped together, one run of a million rows dropped and identified, and a diagnosis
without a test run. Runs are sums of sines with noise, on the built-in arms; those that
are diagnosed are two of the UR10e, 20 s of each, from the folder that
SDP_VS_PENALTY_DATA names. --only: figures whose name has one of these words. Writes
page_timings.csv and page_timings.md.

Other programs on the machine lengthen wall time. Each figure therefore stands beside
the slowdown: wall time over processor time of a fixed loop, run right before and right
after it. A machine with nothing else to do has 1.0; above 1.2 the table says "loaded".
Processor time, of the server and its workers, depends little on other programs.
"""

import argparse
import contextlib
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas
import psutil
from playwright.sync_api import Browser, Page, sync_playwright

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.robot import joint_limits

#: Milliseconds that a step may take on a busy computer.
PATIENCE = 300_000
#: Slowdown above which a machine counts as loaded.
QUIET = 1.2
#: Rows of a run of seven joints whose CSV file is 3 MB.
ROWS_OF_3_MB = 21_000
#: Ends of names of the UR10e's runs that are diagnosed, and the seconds of each.
UR10E_RUNS = ("ur-20_02_19_15harm50sec", "ur-20_02_19_14harm50sec")
UR10E_SECONDS = 20.0
#: Time from a click until the browser has drawn what it changes [s].
CLICK = """link => new Promise(done => {
  const begin = performance.now();
  link.click();
  requestAnimationFrame(() => requestAnimationFrame(
    () => done((performance.now() - begin) / 1000)));
})"""


@dataclass(frozen=True)
class Timing:
    """One figure.

    seconds : of each repetition; processor : of the page's processes, a repetition [s];
    limit : what is asked [s]; slowdown : by other programs, 1 on a quiet machine.
    """

    what: str
    seconds: list[float]
    processor: float
    limit: float
    slowdown: float

    def row(self) -> list[str]:
        """Its cells."""
        state = "quiet" if self.slowdown <= QUIET else "loaded"
        return [
            self.what,
            f"{statistics.median(self.seconds):.3g}",
            f"{max(self.seconds):.3g}",
            f"{self.processor:.3g}",
            str(len(self.seconds)),
            f"{self.limit:g}",
            f"{self.slowdown:.2f}",
            state,
        ]


HEADINGS = [
    "what",
    "median [s]",
    "longest [s]",
    "processor time [s]",
    "repetitions",
    "asked [s]",
    "slowdown",
    "machine",
]


def slowdown() -> float:
    """Wall time over processor time of a loop of about 0.2 s."""
    wall = time.perf_counter()
    processor = time.process_time()
    while time.process_time() - processor < 0.2:
        sum(range(1000))
    return (time.perf_counter() - wall) / (time.process_time() - processor)


def processor_time(server: psutil.Process) -> float:
    """Processor time of the server and of its workers so far [s]."""
    used = 0.0
    for process in (server, *server.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):
            times = process.cpu_times()
            used += times.user + times.system
    return used


def timed(
    what: str,
    limit: float,
    repeats: int,
    once: Callable[[], float],
    server: psutil.Process,
    prepare: Callable[[], None] = lambda: None,
) -> Timing:
    """Repeat a measurement; measure the slowdown around it and the processor time of
    the page's server and workers.

    prepare : what goes before each repetition, and does not count.
    """
    slowdown_before = slowdown()
    seconds, used = [], 0.0
    for _ in range(repeats):
        prepare()
        used_before = processor_time(server)
        seconds.append(once())
        used += processor_time(server) - used_before
    return Timing(
        what,
        seconds,
        processor=used / repeats,
        limit=limit,
        slowdown=(slowdown_before + slowdown()) / 2.0,
    )


def recorded(robot_name: str, rows: int, seed: int) -> Measurements:
    """A run of a built-in arm at 1 kHz that follows sums of sines within the ranges of
    its joints, with torque noise."""
    problem = load_problem(robot_name)
    n = problem.robot.n
    lower, upper, _ = joint_limits(problem.robot)
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * 1e-3
    rates = rng.uniform(0.3, 2.0, (5, n))
    phases = rng.uniform(0.0, 2.0 * np.pi, (5, n))
    sizes = rng.uniform(0.05, 0.2, (5, n))
    angle = t[:, None, None] * rates + phases
    q = (lower + upper) / 2.0 + (sizes * np.sin(angle)).sum(axis=1)
    dq = (sizes * rates * np.cos(angle)).sum(axis=1)
    ddq = -(sizes * rates**2 * np.sin(angle)).sum(axis=1)
    assert problem.nominal_links is not None
    links = np.ravel(problem.nominal_links)
    tau = problem.robot.inverse_dynamics(links, q, dq, ddq)
    tau = tau + 0.01 * np.std(tau, axis=0) * rng.standard_normal(tau.shape)
    return Measurements(t, q, tau)


def write_log(run: Measurements, path: Path) -> None:
    """A CSV file with six decimals, as loggers write it."""
    n = run.n
    names = ["t", *(f"{group}{j}" for group in ("q", "tau") for j in range(1, n + 1))]
    columns = np.column_stack([run.t, run.q, run.tau])
    frame = pandas.DataFrame(columns, columns=names)
    frame.to_csv(path, index=False, float_format="%.6f")


@contextlib.contextmanager
def serving(folder: Path) -> Iterator[tuple[str, psutil.Process]]:
    """The verb's address and process, until it is no longer needed."""
    command = [sys.executable, "-m", "sdp_vs_penalty", "page", "--no-browser"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        printed = re.search(r"http://\S+", process.stdout.readline())
        assert printed is not None
        yield printed[0], psutil.Process(process.pid)
    finally:
        process.terminate()
        process.wait(30)


def open_page(browser: Browser, address: str) -> tuple[Page, float]:
    """A new tab of a browser that has nothing in its cache, and seconds until its first
    stage is drawn."""
    page = browser.new_context().new_page()
    page.set_default_timeout(PATIENCE)
    begin = time.perf_counter()
    page.goto(address.replace("/?", "/new?"))
    page.wait_for_selector("[data-part=robot] .body > *", state="visible")
    return page, time.perf_counter() - begin


def first_load(browser: Browser, address: str) -> float:
    """Seconds until a new tab shows its first stage."""
    page, seconds = open_page(browser, address)
    page.context.close()
    return seconds


def drop(
    browser: Browser, address: str, robot_name: str, files: list[Path]
) -> tuple[Page, float]:
    """A tab with a robot and files dropped on it, and seconds until the table of runs
    shows them."""
    page, _ = open_page(browser, address)
    page.click(f'[data-key="robot-{robot_name}"]')
    page.wait_for_selector('[data-key="drop-runs"]', state="attached")
    page.wait_for_selector(".working", state="hidden")
    begin = time.perf_counter()
    page.set_input_files('[data-key="drop-runs"]', [str(file) for file in files])
    page.wait_for_selector(f"table.runs tbody tr:nth-child({len(files)})")
    seconds = time.perf_counter() - begin
    page.wait_for_selector(".working", state="hidden")
    return page, seconds


def drop_seconds(
    browser: Browser, address: str, robot_name: str, files: list[Path]
) -> float:
    """Seconds from dropping files until the table of runs shows them."""
    page, seconds = drop(browser, address, robot_name, files)
    page.context.close()
    return seconds


def click_seconds(page: Page, stages: Iterator[str]) -> float:
    """Seconds from a click on the next stage until it is drawn."""
    link = page.locator(f"nav.stages [data-to={next(stages)}]")
    return float(link.evaluate(CLICK))


def act_seconds(page: Page, stage: str, control: str, shown: str) -> float:
    """Seconds from pressing a control of a stage until what it makes is drawn."""
    page.click(f"nav.stages [data-to={stage}]")
    page.wait_for_selector(".working", state="hidden")
    begin = time.perf_counter()
    page.click(f'[data-key="{control}"]')
    page.wait_for_selector(shown)
    seconds = time.perf_counter() - begin
    page.wait_for_selector(".working", state="hidden")
    return seconds


def identify_seconds(page: Page) -> float:
    """Seconds from pressing Identify until the fit is drawn."""
    return act_seconds(page, "identify", "identify", "[data-part=fit] .js-line")


def diagnose_seconds(page: Page) -> float:
    """Seconds from pressing Diagnose until it says what it found."""
    shown = '[data-key="diagnose"]:has-text("Diagnose again")'
    return act_seconds(page, "diagnose", "diagnose", shown)


def written_ur10e_runs(folder: Path) -> list[Path]:
    """Write two measured runs of the UR10e, 20 s of each, as the benchmarks have them."""
    files = []
    for run in measured_runs("ur10e").values():
        if run.names[0].endswith(UR10E_RUNS):
            files.append(folder / f"{run.names[0]}.csv")
            save(run.window(0.0, UR10E_SECONDS), files[-1])
    assert len(files) == len(UR10E_RUNS)
    return files


@dataclass
class Measuring:
    """A page that is measured: its files, its address and process, and a browser."""

    folder: Path
    repeats: int
    only: list[str]
    address: str
    server: psutil.Process
    browser: Browser
    #: The tab on which the next repetition works.
    page: Page | None = None

    def figures(self) -> Iterator[Timing]:
        """Measure one figure after the other."""
        first_load(self.browser, self.address)  # the server imports what it needs
        yield from self.figure(
            "first load of the page",
            limit=1.0,
            once=lambda: first_load(self.browser, self.address),
        )
        three = [self.folder / f"run{k}.csv" for k in (1, 2, 3)]
        for seed, file in enumerate(three):
            write_log(recorded("panda", ROWS_OF_3_MB, seed), file)
        size = sum(file.stat().st_size for file in three) / 3e6
        yield from self.figure(
            f"three runs of {size:.1f} MB dropped until they are listed",
            limit=3.0,
            once=lambda: drop_seconds(self.browser, self.address, "panda", three),
        )
        stages = iter(["check", "identify", "measure"] * 20)
        yield from self.figure(
            "click on a stage until it is drawn, three runs loaded",
            limit=0.1,
            once=lambda: click_seconds(self.tab, stages),
            prepare=lambda: self.open("panda", three, again=False),
            repeats=30,
        )
        long_run = self.folder / "long.csv"
        write_log(recorded("two_link", 1_000_000, 9), long_run)
        size = long_run.stat().st_size / 1e6
        yield from self.figure(
            f"run of 1 000 000 rows ({size:.0f} MB) dropped until it is listed",
            limit=5.0,
            once=lambda: drop_seconds(
                self.browser, self.address, "two_link", [long_run]
            ),
        )
        yield from self.figure(
            "run of 1 000 000 rows identified, until the fit is drawn",
            limit=15.0,
            once=lambda: identify_seconds(self.tab),
            prepare=lambda: self.open("two_link", [long_run]),
        )

        def identify_ur10e() -> None:
            self.open("ur10e", written_ur10e_runs(self.folder))
            identify_seconds(self.tab)

        yield from self.figure(
            "two runs of the UR10e diagnosed without a test run",
            limit=20.0,
            once=lambda: diagnose_seconds(self.tab),
            prepare=identify_ur10e,
        )

    def figure(
        self,
        what: str,
        limit: float,
        once: Callable[[], float],
        prepare: Callable[[], None] = lambda: None,
        repeats: int | None = None,
    ) -> Iterator[Timing]:
        """Measure a figure if it was asked for."""
        if not self.only or any(word in what for word in self.only):
            count = self.repeats if repeats is None else repeats
            yield timed(what, limit, count, once, self.server, prepare)

    @property
    def tab(self) -> Page:
        """The open tab."""
        assert self.page is not None
        return self.page

    def open(self, robot_name: str, files: list[Path], again: bool = True) -> None:
        """Open a tab with these runs; leave it where one is open already, if it is not
        needed ``again``."""
        if self.page is not None and not again:
            return
        if self.page is not None:
            self.page.context.close()
        self.page, _ = drop(self.browser, self.address, robot_name, files)
        self.page.wait_for_timeout(2000)


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path())
    parser.add_argument("--only", nargs="+", default=[])
    options = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    with (
        tempfile.TemporaryDirectory() as temporary,
        serving(Path(temporary)) as (address, server),
        sync_playwright() as play,
    ):
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        measuring = Measuring(
            Path(temporary), options.repeats, options.only, address, server, browser
        )
        figures = [*measuring.figures()]
        browser.close()
    table = Table(
        HEADINGS,
        [figure.row() for figure in figures],
        title="How long the page takes",
        caption="Wall time in Chromium. Slowdown: by other programs on the machine."
        " Processor time: of the server and its workers.",
    )
    write_text(options.out / "page_timings.csv", table.csv())
    write_text(options.out / "page_timings.md", table.markdown())
    print(table.markdown())


if __name__ == "__main__":
    main()
