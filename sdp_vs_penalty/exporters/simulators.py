"""A model as an object of another library: Pinocchio's Model, MuJoCo's MjSpec."""

from __future__ import annotations

import warnings
from typing import Any

from sdp_vs_penalty.effects import effect_in_words
from sdp_vs_penalty.errors import InputError, Remark, missing_extra
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters import mjcf
from sdp_vs_penalty.exporters.content import Content, Options


def to_pinocchio(estimate: Estimate) -> Any:
    """Return a model as a Pinocchio Model: links, armature, viscous and Coulomb
    friction.

    Its inverse dynamics hold the links and the armature; friction stands in its fields
    ``damping`` and ``friction`` (``frictionLoss`` in older versions). Other effects are
    left out, as in a URDF (see :func:`~sdp_vs_penalty.exporters.export.as_exported`).

    Parameters
    ----------
    estimate : Estimate
        A model with a rigid_body effect.

    Returns
    -------
    pinocchio.Model
        One joint for each joint of the robot's tree, in its order.

    Raises
    ------
    InputError
        For a model without links, with an inconsistent link, or with joints that follow
        others, which a Pinocchio Model does not couple.
    """
    robot = estimate.robot
    if robot.mechanism is not None:
        raise InputError(
            f"model {estimate.problem.name}: some of its joints follow others",
            "export it as MJCF or URDF, which can say so",
        )
    content = Content.plausible(estimate, Options())
    model = robot.pinocchio_model(estimate.links)
    # Pinocchio 4 knows bounds of dry friction; earlier versions one number.
    model.armature, model.damping = content.armature, content.damping
    model.friction = content.friction
    return model


def to_mjspec(estimate: Estimate) -> Any:
    """Return a model as MuJoCo's MjSpec: links, armature, damping, dry friction,
    springs, offsets and gears. A warning names the effects that MuJoCo cannot hold, as
    ``export`` to .xml does.

    Parameters
    ----------
    estimate : Estimate
        A model with a rigid_body effect.

    Returns
    -------
    mujoco.MjSpec
        To be edited further, or compiled by ``spec.compile()``.

    Raises
    ------
    InputError
        For a model without links, or a link that MuJoCo cannot load; without MuJoCo
        (extra [engines]).
    """
    try:
        import mujoco
    except ImportError as error:
        raise missing_extra("An MjSpec needs", "engines") from error
    content, lost = mjcf.write(estimate, Options())
    if lost:
        names = ", ".join(map(effect_in_words, lost))
        warnings.warn(f"MuJoCo cannot hold {names}", Remark, stacklevel=3)
    return mujoco.MjSpec.from_string(content.decode())
