"""Outputs: whole or not at all, never over an input, whatever the name under which it
is reached."""

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest
from arms import write_folder
from commands import run_cli
from recorded import refusal
from small_runs import small_run, write_run

from sdp_vs_penalty import InputError, files, load_measurements, load_problem
from sdp_vs_penalty.data import save


@pytest.fixture
def log(tmp_path):
    return write_run(tmp_path / "run.csv", load_problem("two_link"))


@pytest.mark.parametrize("how", ["same", "equals", "relative", "symlink", "hard link"])
def test_an_input_is_never_replaced(log, how, tmp_path, monkeypatch, capsys):
    before = log.read_bytes()
    out = log
    data = ["--data", str(log)]
    if how == "equals":
        data = [f"--data={log}"]
    elif how == "relative":
        monkeypatch.chdir(tmp_path)
        out = Path("./run.csv")
    elif how == "symlink":
        out = tmp_path / "link.csv"
        out.symlink_to(log)
    elif how == "hard link":
        out = tmp_path / "other.csv"
        os.link(log, out)
    assert run_cli("identify", "two_link", *data, "--out", out) == 2
    assert "also an input" in capsys.readouterr().err
    assert log.read_bytes() == before


def test_what_only_a_reader_opens_is_protected_too(log, tmp_path):
    """A problem's folder is named on the command line, its table of bounds is not."""
    folder = write_folder(tmp_path / "arm")
    before = (folder / "bounds.csv").read_bytes()
    assert (
        run_cli(
            "identify",
            folder,
            "--data",
            log,
            "--out",
            folder / "bounds.csv",
            "--no-check",
        )
        == 2
    )
    assert (folder / "bounds.csv").read_bytes() == before


def test_a_notebook_may_write_over_what_it_read(tmp_path):
    path = tmp_path / "model.json"
    path.write_text("old")
    files.opened(path)
    files.write_text(path, "new")
    assert path.read_text() == "new"
    with files.protecting():
        files.opened(path)
        refusal(lambda: files.write_text(path, "newer"), "also an input")
    files.write_text(path, "newest")
    assert path.read_text() == "newest"


def test_a_device_stays_a_device(tmp_path):
    files.write_text("/dev/null", "content")
    assert Path("/dev/null").is_char_device()
    refusal(lambda: files.write_text("/dev/full", "content"), "cannot be written")
    fifo = tmp_path / "pipe"
    os.mkfifo(fifo)
    got = []
    reader = threading.Thread(target=lambda: got.append(fifo.read_text()))
    reader.start()
    files.write_text(fifo, "through")
    reader.join(10)
    assert got == ["through"]
    assert fifo.is_fifo()


def test_a_link_stays_and_its_target_is_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    target = tmp_path / "real" / "model.json"
    link = tmp_path / "model.json"
    target.write_text("old")
    link.symlink_to(target)
    files.write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    dangling = tmp_path / "later.json"
    dangling.symlink_to(tmp_path / "real" / "later.json")
    files.write_text(dangling, "made")
    assert dangling.is_symlink()
    assert (tmp_path / "real" / "later.json").read_text() == "made"


@pytest.mark.parametrize("name", ["x" * 250, "機" * 80])
def test_a_name_as_long_as_it_may_be_is_written(tmp_path, name):
    files.write_text(tmp_path / name, "content")
    assert (tmp_path / name).read_text() == "content"


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"])
def test_a_name_that_cannot_be_is_one_sentence(tmp_path, name):
    refusal(lambda: files.write_text(tmp_path / name, "content"), "cannot be written")
    assert list(tmp_path.iterdir()) == []


STEPS = ("content", "open", "fsync", "link", "close", "replace")
FAULTS = [OSError(28, "No space left on device"), KeyboardInterrupt(), None]


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("error", FAULTS, ids=repr)
@pytest.mark.parametrize("is_nameless", [True, False], ids=["nameless", "named"])
def test_a_fault_at_any_step_keeps_the_old_file(
    step, error, is_nameless, tmp_path, monkeypatch
):
    """An error, an interruption, and the end of the process (None), after which nothing
    is tidied up."""
    if is_nameless and not hasattr(os, "O_TMPFILE"):
        pytest.skip("no nameless files on this system")
    if not is_nameless:
        if step == "link":
            pytest.skip("a named file needs no link")
        monkeypatch.setattr(files, "_nameless_file", lambda folder: None)
    path = tmp_path / "model.json"
    files.write_text(path, "old")
    whole = getattr(os, step, None)

    def fails(*arguments, **named):
        if step == "close":
            whole(*arguments)
        if error is None:
            os._exit(9)
        raise error

    def write():
        with monkeypatch.context() as patch:
            patch.setattr(
                f"sdp_vs_penalty.files.os.{step}", fails, raising=step != "content"
            )
            with files.writing(path) as file:
                file.write(b"new" * 100_000)
                if step == "content":
                    fails()

    if error is None:
        if not (child := os.fork()):
            with suppress(BaseException):
                write()
            os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
        assert path.read_text() == "old"
        if is_nameless and step in ("content", "open", "fsync", "link"):
            assert [p.name for p in tmp_path.iterdir()] == ["model.json"]
        files.write_text(path, "old")  # and the next writer takes away what is left
    else:
        with pytest.raises((InputError, KeyboardInterrupt)):
            write()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]


def test_the_largest_size_is_the_last_that_is_read(tmp_path):
    path = tmp_path / "ten"
    path.write_bytes(b"0123456789")
    assert files.read_bytes(path, 10) == b"0123456789"
    for other, largest in (
        (path, 9),
        (Path("/proc/self/status"), 9),
    ):  # which states no size
        if other.exists():
            refusal(
                lambda path=other, most=largest: files.read_bytes(path, most),
                "larger than",
            )


def test_what_a_living_writer_has_begun_stays(tmp_path):
    begun = [
        tmp_path / f".model.json.{process}.0.part" for process in (os.getppid(), 2**30)
    ]
    for path in begun:
        path.write_text("half")
    files.write_text(tmp_path / "model.json", "whole")
    assert [path.exists() for path in begun] == [True, False]


def test_threads_that_read_leave_the_limits_of_the_process(tmp_path, two_link):
    """Limits hold for all threads of a process: reading must not even lower them for a
    while."""
    resource = pytest.importorskip("resource")
    kinds = resource.RLIMIT_DATA, resource.RLIMIT_FSIZE, resource.RLIMIT_AS
    before = [resource.getrlimit(kind) for kind in kinds]
    run = small_run(two_link)
    paths = [tmp_path / f"run.{end}" for end in ("csv", "npz", "parquet", "mat")]
    for path in paths:
        save(run, path)
    limits = []

    def read(path):
        with files.reading(path):
            limits.append([resource.getrlimit(kind) for kind in kinds])
        load_measurements(path)
        limits.append([resource.getrlimit(kind) for kind in kinds])

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(read, [*paths, *paths]))
    assert limits == [before] * 16


def test_a_folder_that_cannot_be_made_is_a_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(InputError, match="cannot be written"),
        files.folder_lock(tmp_path / "file" / "out"),
    ):
        pass
