"""The same bytes in every locale, also where a program around this one has set it."""

import locale
import sys

import pytest
from mutations import sound_meshes
from other_locales import make_locales, set_locale
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.cli.main import main
from sdp_vs_penalty.data import save

pytest.importorskip("psutil", reason="its helper counts processes")
import killing

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="commands are forked as on Linux"
)
COMMANDS = {
    "text": "identify two_link --data run.csv --out out/model.json --proof out/proof.json",
    "a mesh": "check-urdf arm.urdf --json out/arm.json",
    "matrices": "convert run.mat --out out/run.csv",
    "a URDF": "export model.json --out out/arm.urdf",
    "an SDP": "export-sdp two_link --data run.csv --out out/problem.cbf",
    "C": "export model.json --out out/arm.h",
}
ARM = """<robot name="r"><link name="b"/><link name="l"><inertial><mass value="1.5"/>
<inertia ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial><collision>
<geometry><mesh filename="mesh.ply" scale="0.5 0.5 0.5"/></geometry></collision></link>
<joint name="j" type="continuous"><parent link="b"/><child link="l"/>
<axis xyz="0 1 0"/></joint></robot>"""


@pytest.fixture(scope="module")
def home(two_link, tmp_path_factory):
    """A folder of inputs."""
    folder = tmp_path_factory.mktemp("inputs")
    run = small_run(two_link)
    for suffix in (".csv", ".mat"):
        save(run, folder / f"run{suffix}")
    sdp.identify(two_link, run).save(folder / "model.json")
    (folder / "arm.urdf").write_text(ARM)
    (folder / "mesh.ply").write_bytes(sound_meshes()[".ply"])
    return folder


@pytest.fixture(scope="module")
def locales(tmp_path_factory):
    """A folder of locales, and their names."""
    folder = tmp_path_factory.mktemp("locales")
    names = make_locales(folder)
    if not names:
        pytest.skip("no localedef that makes locales")
    return folder, names


def written(home):
    return {path.name: path.read_bytes() for path in (home / "out").iterdir()}


#: Numbers that are written, computed and read as text are long, the others slow.
MARKS = dict.fromkeys(("C", "text", "a mesh"), pytest.mark.long)
CASES = [
    pytest.param(what, marks=MARKS.get(what, pytest.mark.slow)) for what in COMMANDS
]


@pytest.mark.parametrize("what", CASES)
def test_every_locale_writes_the_same_bytes(what, home, locales):
    folder, names = locales
    words = COMMANDS[what].split()
    assert killing.run_to_end(lambda: main(words), home)[0] == 0
    right = written(home)
    for name in names:

        def in_locale(name=name):
            assert set_locale(name, folder)
            assert not name.startswith("de") or locale.str(1.5) == "1,5"
            main(words)

        code, _ = killing.run_to_end(in_locale, home)
        assert code == 0, (home / "printed").read_text()
        assert written(home) == right
