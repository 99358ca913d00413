"""Units of the problem: lengths in millimetres, masses in grams, inertias times 1e6.

Read from the robot itself, whatever was measured. The rules are
:func:`sdp_vs_penalty.robot.plausible_units.odd_units`, which `check-urdf` uses too.
"""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.certainty import told_by
from sdp_vs_penalty.checks.issue import Issue, make_issue
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import nonzero_or_one
from sdp_vs_penalty.robot.inertia import inertia_matrix
from sdp_vs_penalty.robot.plausible_units import LinkSizes, odd_units


def problem_units(problem: Problem) -> Iterator[Issue]:
    """Yield a warning for each quantity of the problem's links that is in another unit
    than SI: lengths in millimetres, masses in grams, inertias times 1e6.

    Nothing is yielded where the links are guesses of ours.
    """
    if np.all(problem.guessed_links):
        return
    robot = problem.robot
    names = [robot.tree[k].name for k in robot.link_joints]
    steps = [float(np.linalg.norm(joint.placement[:3, 3])) for joint in robot.tree]
    sizes = []
    for name, link in zip(names, problem.nominal_links, strict=True):
        mass = float(link[0])
        com = link[1:4] / nonzero_or_one(mass)
        about_frame = inertia_matrix(link[4:])
        # Steiner's theorem.
        about_com = about_frame - mass * (com @ com * np.eye(3) - np.outer(com, com))
        largest_inertia = float(np.linalg.eigvalsh(about_com)[-1])
        distance = float(np.linalg.norm(com))
        sizes.append(LinkSizes(name, mass, distance, largest_inertia))
    odd = list(odd_units(sizes, max(steps)))
    if any(unit.quantity == "lengths" for unit in odd):
        # Links whose moments are too small for lengths in mm are given larger ones.
        odd = [unit for unit in odd if unit.quantity != "inertias"]
    for unit in odd:
        yield make_issue(
            kind="units of the problem",
            in_doubt="units of the problem",
            where="the problem",
            what=f"{unit.what} Nothing is said of the torques.",
            certainty=told_by("read from the problem", "no arm is of that size"),
            remedy=unit.remedy,
            figures={"quantity": unit.quantity, "factor": unit.factor},
        )
