"""Parsers in a process of their own: a crash, a silence or a claim of memory is one
error there, and nothing here."""

import json
import os
import threading
import time

import numpy as np
import parsers
import pytest

from sdp_vs_penalty import InputError, load_measurements
from sdp_vs_penalty.data import save
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.robot import (
    ParserEndedError,
    isolated,
    link_geometry,
    parse_isolated,
    read_mesh,
)

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="children are forked")
CUBE = "".join(
    f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)
) + "".join(
    f"f {face}\n"
    for face in ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
)


@pytest.fixture(scope="module")
def _servers_that_know_the_parsers():
    """A server that another test file has started does not know these parsers, and
    those that are started here end here."""

    def end_servers():
        for server in isolated._idle:
            server.process.kill()
            server.process.wait()
        isolated._idle.clear()

    end_servers()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.path.dirname(parsers.__file__))
        yield
    end_servers()


@pytest.fixture(params=["forked here", "from a server"])
def file(request, monkeypatch, tmp_path, _servers_that_know_the_parsers):
    """A file to parse, by a child of this process or of a server."""
    is_here = request.param == "forked here"
    monkeypatch.setattr(isolated, "_is_single_threaded", lambda: is_here)
    path = tmp_path / "file"
    path.write_bytes(b"1")
    return path


def test_arrays_come_back_in_order(file):
    found = [x["number"] for x in parse_isolated(parsers.echo, file, [1.0, 2.0])]
    assert [x.shape for x in found] == [(2, 3), (2, 3)]
    assert [x[0, 0] for x in found] == [1.0, 2.0]


def test_a_crash_is_an_error(file):
    with pytest.raises(ParserEndedError, match="ended by SIGABRT"):
        list(parse_isolated(parsers.crash, file))


def test_a_silence_is_an_error(file):
    with pytest.raises(ParserEndedError, match="gave no answer for"):
        list(parse_isolated(parsers.wait, file, seconds=0.5))


def test_a_loop_is_an_error(file):
    begin = time.monotonic()
    with pytest.raises(ParserEndedError):
        list(parse_isolated(parsers.work, file, seconds=1.0))
    assert time.monotonic() - begin < 15.0


@pytest.mark.skipif(
    not os.path.exists("/proc/self/statm"), reason="memory is limited on Linux"
)
def test_too_much_memory_is_an_error(file):
    with pytest.raises(MemoryError):
        list(parse_isolated(parsers.fill, file))


def test_sentences_and_remarks_come_back(file):
    with (
        pytest.warns(Remark, match="row 3 is odd"),
        pytest.raises(InputError, match="file: row 4 is wrong: delete it"),
    ):
        list(parse_isolated(parsers.refuse, file))


@pytest.mark.skipif(
    os.uname().machine not in ("x86_64", "aarch64"), reason="the filter knows these"
)
@pytest.mark.parametrize("parser", [parsers.connect, parsers.start])
def test_no_network_and_no_program(parser, file):
    with pytest.raises(ParserEndedError, match="not permitted"):
        list(parse_isolated(parser, file))


def test_an_abandoned_reading_hinders_no_other(file):
    first = parse_isolated(parsers.echo, file, [1.0] * 1000)
    next(first)
    (found,) = parse_isolated(parsers.echo, file, [3.0])
    assert found["number"][0, 0] == 3.0


def test_no_process_is_left(file):
    psutil = pytest.importorskip("psutil")
    with pytest.raises(ParserEndedError):
        list(parse_isolated(parsers.wait, file, seconds=0.2))
    time.sleep(0.2)
    left = [p.name() for p in psutil.Process().children(recursive=True)]
    assert len(left) <= len(isolated._idle) + 1


@pytest.fixture
def two_link_run(two_link):
    from small_runs import small_run

    return small_run(two_link)


def deep(tag, middle):
    return f"<{tag}>" * 30_000 + middle + f"</{tag}>" * 30_000


GLTF_LOOP = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"children": [0]}],
    "buffers": [],
}
BROKEN = {
    "loop.gltf": json.dumps(GLTF_LOOP),
    "deep.gltf": '{"buffers":' + "[" * 50_000,
    "deep.x3d": f"<X3D><Scene>{deep('Group', '')}</Scene></X3D>",
    "deep.dae": (
        '<COLLADA version="1.4.1"><library_visual_scenes><visual_scene id="s">'
        + deep("node", "")
        + "</visual_scene></library_visual_scenes><scene>"
        '<instance_visual_scene url="#s"/></scene></COLLADA>'
    ),
    "loop.dae": (
        '<COLLADA version="1.4.1"><library_nodes><node id="n"><instance_node url="#n"/>'
        '</node></library_nodes><library_visual_scenes><visual_scene id="s">'
        '<instance_node url="#n"/></visual_scene></library_visual_scenes><scene>'
        '<instance_visual_scene url="#s"/></scene></COLLADA>'
    ),
    "claim.stl": "\0" * 80 + "\x7f\x7f\x7f\x7f" + "\0" * 50,
    "noise.ply": "ply\nformat ascii 1.0\nelement vertex 99999999999\n",
    "unknown.irr": "<irr_scene/>",
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_mesh_is_left_out(name, tmp_path):
    (tmp_path / name).write_text(BROKEN[name])
    with pytest.warns(Remark, match="this mesh is left out"):
        assert read_mesh(tmp_path / name, np.ones(3)) is None


@pytest.mark.parametrize("line", ["mtllib {}", "  mtllib {}", "map_Kd {}"])
def test_what_an_obj_names_is_not_opened(line, tmp_path):
    pipe = tmp_path / "pipe.mtl"
    os.mkfifo(pipe)
    (tmp_path / "cube.obj").write_text(f"{line.format(pipe)}\n{CUBE}")
    begin = time.monotonic()
    mesh = read_mesh(tmp_path / "cube.obj", np.ones(3))
    assert mesh.volume == pytest.approx(1.0)
    assert time.monotonic() - begin < 5.0


def gltf(uri):
    """One triangle whose corners are in a buffer."""
    accessor = {"componentType": 5126, "count": 3, "type": "VEC3", "bufferView": 0}
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "scene": 0,
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [accessor],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": uri}],
            "images": [{"uri": "/dev/zero"}],
        }
    )


def test_the_buffer_of_a_gltf_is_read(tmp_path):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    (tmp_path / "corners.bin").write_bytes(corners.tobytes())
    (tmp_path / "part.gltf").write_text(gltf("corners.bin"))
    mesh = read_mesh(tmp_path / "part.gltf", np.full(3, 2.0), triangles=True)
    assert mesh.vertices.tolist() == (2.0 * corners).tolist()
    assert mesh.triangles.shape == (1, 3)


@pytest.mark.parametrize("uri", ["pipe.bin", "/dev/zero", "../secret.bin", "gone.bin"])
def test_a_buffer_that_is_no_file_of_the_folder_is_not_read(uri, tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    os.mkfifo(home / "pipe.bin")
    (tmp_path / "secret.bin").write_bytes(b"\0" * 36)
    (home / "part.gltf").write_text(gltf(uri))
    begin = time.monotonic()
    with pytest.warns(Remark, match="this mesh is left out"):
        assert read_mesh(home / "part.gltf", np.ones(3)) is None
    assert time.monotonic() - begin < 5.0


def test_a_mesh_of_a_name_that_none_can_have_is_not_there(tmp_path):
    for name in ("m" * 5000 + ".stl", "m" * 300 + ".stl"):
        (tmp_path / "arm.urdf").write_text(ARM.format(f'<mesh filename="{name}"/>'))
        assert link_geometry(tmp_path / "arm.urdf") == [None]


@pytest.mark.parametrize(
    "shape",
    ['<sphere radius="1e300"/>', '<box size="1 1e200 1"/>', '<sphere radius="inf"/>'],
)
def test_a_shape_that_no_robot_has_is_refused(shape, tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM.format(shape))
    with pytest.raises(InputError, match="has a length beyond"):
        link_geometry(tmp_path / "arm.urdf")


ARM = """<robot name="arm"><link name="base"/><link name="l"><collision><geometry>
{}</geometry></collision></link><joint name="j" type="continuous"><parent link="base"/>
<child link="l"/></joint></robot>"""


def test_a_thread_makes_the_server_parse(tmp_path, two_link_run):
    end = threading.Event()
    threading.Thread(target=end.wait, daemon=True).start()
    try:
        save(two_link_run, tmp_path / "run.mat")
        assert len(load_measurements(tmp_path / "run.mat").t) == len(two_link_run.t)
        assert isolated._idle
    finally:
        end.set()


def test_a_log_that_needs_no_parser_starts_no_process(tmp_path, two_link_run):
    save(two_link_run, tmp_path / "run.csv")
    before = len(isolated._idle)
    load_measurements(tmp_path / "run.csv")
    assert len(isolated._idle) == before
