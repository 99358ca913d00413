"""Meshes of a URDF as the page draws them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sdp_vs_penalty.render.arms import binary_stl, simplified
from sdp_vs_penalty.robot import link_surfaces

#: A tetrahedron as a text STL.
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def text_stl():
    facets = ""
    for face in FACES:
        corners = "".join(
            f"vertex {x} {y} {z}\n" for x, y, z in CORNERS[list(face)].tolist()
        )
        facets += f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n"
    return f"solid tetra\n{facets}endsolid tetra\n"


def urdf(filename):
    """An arm of one joint whose link has a mesh, scaled and displaced."""
    return f"""<robot name="one"><link name="base"/><link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial><visual><origin xyz="0 0 2"/>
    <geometry><mesh filename="{filename}" scale="0.5 0.5 0.5"/></geometry></visual></link>
    <joint name="j" type="revolute"><parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
    </robot>"""


def sphere(n):
    """(m, 3, 3) triangles of a unit sphere."""
    u, v = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n))
    grid = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], -1)
    a, b = grid[:-1, :-1], grid[1:, :-1]
    c, d = grid[1:, 1:], grid[:-1, 1:]
    halves = [np.stack([a, b, c], 2), np.stack([a, c, d], 2)]
    return np.concatenate([half.reshape(-1, 3, 3) for half in halves])


@pytest.mark.parametrize(
    "place", ["meshes/tetra.stl", "package://one/meshes/tetra.stl"]
)
def test_a_mesh_beside_the_urdf_is_read_with_its_pose_and_scale(tmp_path, place):
    folder = tmp_path / "one"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "tetra.stl").write_text(text_stl())
    (folder / "one.urdf").write_text(urdf(place))
    (surface,) = link_surfaces(folder / "one.urdf")
    assert surface.shape == (4, 3, 3)
    assert_allclose(surface.min(axis=(0, 1)), [0.0, 0.0, 2.0])
    assert_allclose(surface.max(axis=(0, 1)), [0.5, 0.5, 2.5])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("content", [None, "no mesh at all"])
def test_a_mesh_that_cannot_be_read_is_left_out(tmp_path, content):
    (tmp_path / "one.urdf").write_text(urdf("tetra.stl"))
    if content is not None:
        (tmp_path / "tetra.stl").write_text(content)
    assert link_surfaces(tmp_path / "one.urdf") == [None]


def test_a_fine_mesh_becomes_a_coarse_one_of_the_same_size():
    fine = sphere(70)
    coarse = simplified(fine, 3000)
    assert 500 < len(coarse) <= 3000
    assert_allclose(np.ptp(coarse, axis=(0, 1)), 2.0, atol=0.1)


def test_a_coarse_mesh_stays():
    assert simplified(CORNERS[FACES]) is not None
    assert_array_equal(simplified(CORNERS[FACES]), CORNERS[FACES])


def test_a_binary_stl_holds_normals_and_corners():
    written = binary_stl(CORNERS[FACES])
    assert len(written) == 84 + 4 * 50
    assert int.from_bytes(written[80:84], "little") == 4
    first = np.frombuffer(written[84:132], "<f4")
    assert_allclose(first[:3], [0.0, 0.0, -1.0])
    assert_allclose(first[3:].reshape(3, 3), CORNERS[list(FACES[0])])
