"""A description of a planar arm whose right angles are written in nine digits: its axes
are parallel but for rounding."""

import pytest

from sdp_vs_penalty import check, simulate
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.race.rows import RegressionData

#: Place, turn (roll, pitch, yaw) and axis of each joint; mass of its link and centre.
JOINTS = [
    ("0 0 0.07", "2.67794504 1.57079633 1.10714872", "0 0 -1", 1.8, "-0.06 0 0"),
    ("-0.15 0 -0.01", "0.785398163 -1.57079633 2.35619449", "1 0 0", 0.9, "0 0 -0.03"),
    ("0 0 -0.14", "-3.14159265 0 -1.57079633", "0 1 0", 0.5, "0 0 0.02"),
]
#: Of each link gravity moves a mass along two directions, and acceleration an inertia.
PARAMETERS_PER_LINK = 3


@pytest.fixture
def planar(tmp_path):
    """Three parallel axes in a vertical plane, in frames that are turned against each
    other by right angles."""
    text = '<robot name="planar"><link name="link0"/>'
    for k, (place, turn, axis, mass, centre) in enumerate(JOINTS, start=1):
        inertia = 2e-3 * mass
        text += f"""
          <link name="link{k}"><inertial>
            <origin xyz="{centre}"/><mass value="{mass}"/>
            <inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}"
              ixy="0" ixz="0" iyz="0"/>
          </inertial></link>
          <joint name="joint{k}" type="revolute">
            <parent link="link{k - 1}"/><child link="link{k}"/>
            <origin xyz="{place}" rpy="{turn}"/><axis xyz="{axis}"/>
            <limit lower="-2.9" upper="2.9" effort="30" velocity="5"/>
          </joint>"""
    path = tmp_path / "planar.urdf"
    path.write_text(f"{text}</robot>")
    return as_problem(path)


def test_rounding_makes_no_parameters(planar):
    run = simulate(planar, seed=1).test
    settings = planar.preprocessing.resolve(run)
    independent = RegressionData.from_run(planar, run, settings).independent
    assert len(independent) == PARAMETERS_PER_LINK * len(JOINTS)


def test_a_clean_log_of_a_planar_arm_is_silent(planar):
    (report,) = check(planar, simulate(planar, seed=1).test)
    assert not report.errors_and_warnings
