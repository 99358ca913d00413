"""A disk that is full at any write: a sentence, files that are whole or not there, and
nothing of before is lost."""

import os
from contextlib import suppress

import numpy as np
import pytest
from disks import small_disk
from page_sessions import Here, do, opened, saved
from small_runs import small_run

from sdp_vs_penalty import InputError
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.page import Sessions
from sdp_vs_penalty.paper.tables import StudyTable

#: Room of a disk [KiB]; the smallest pages of a file system have 4.
ROOMS = (4, 8, 12, 16, 20, 28, 40)


@pytest.fixture
def disk(tmp_path):
    """A folder in the place of which a small file system can be."""
    with small_disk(tmp_path / "probe", 4) as is_small:
        if not is_small:
            pytest.skip("only root can mount a file system")
    (tmp_path / "disk").mkdir()
    return tmp_path / "disk"


@pytest.fixture(scope="module")
def table():
    rows = [{"name": f"row {k}", "value": k / 7.0} for k in range(150)]
    return StudyTable("A table", rows, name="III", caption="Simulated.")


@pytest.mark.parametrize("room", ROOMS)
def test_a_table_is_whole_or_not_there(room, table, disk, tmp_path):
    table.write(tmp_path / "right")
    right = {path.name: path.read_bytes() for path in (tmp_path / "right").iterdir()}
    with small_disk(disk, room):
        with suppress(InputError):
            table.write(disk)
        written = {path.name: path.read_bytes() for path in disk.iterdir()}
    assert written.items() <= right.items()
    assert room < max(ROOMS) or written == right


def test_what_was_there_before_stays(table, disk):
    with small_disk(disk, 24):
        table.write(disk)
        before = {path.name: path.read_bytes() for path in disk.iterdir()}
        write_bytes(disk / "filling", b"x" * sum(disk_free(disk)))
        with pytest.raises(InputError, match="No space left"):
            table.write(disk)
        (disk / "filling").unlink()
        assert {path.name: path.read_bytes() for path in disk.iterdir()} == before


def disk_free(folder):
    """The sizes of what still fits into the folder, pages of a new file aside."""
    state = os.statvfs(folder)
    return [state.f_bavail * state.f_frsize]


MORE_ROOMS = [
    *(pytest.param(room, marks=pytest.mark.long) for room in (16, 256)),
    *(pytest.param(room, marks=pytest.mark.slow) for room in (128, 512)),
]


@pytest.mark.parametrize("room", [64, *MORE_ROOMS])
def test_a_page_on_a_full_disk_keeps_its_session(
    room, two_link, disk, tmp_path, monkeypatch
):
    files = saved(tmp_path, [small_run(two_link)], "a.csv")
    with small_disk(disk, room):
        monkeypatch.setattr("tempfile.tempdir", str(disk))
        sessions = Sessions(Here())
        try:
            session = opened(sessions, "two_link")
            sentences = []
            for act in (
                lambda: read(session, files),
                lambda: do(session, session.identify),
            ):
                n_models = len(session.history)
                try:
                    act()
                except InputError as error:
                    sentences.append(str(error))
                    # A model that stands while its project has no room is not lost.
                    is_made = "The project is not saved" in str(error)
                    assert len(session.history) - n_models in {0, is_made}
            assert_whole(session)
            assert not any("Internal error" in text for text in sentences), sentences
            assert sentences or session.history
        finally:
            sessions.close()


def read(session, files):
    session.arrived.update(files)
    do(session, session.read_files)


def assert_whole(session):
    """No file of the session is partial."""
    for path in session.folder.iterdir():
        assert path.suffix != ".part"
        if path.suffix == ".npz":
            with np.load(path) as arrays:
                assert all(arrays[name].size for name in arrays)
