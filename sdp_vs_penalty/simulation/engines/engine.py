"""The base class of physics engines: an engine loads a robot, computes its torques, and
follows joint velocities.

A file in this folder that defines a subclass of :class:`Engine` is its registration.
The robot reaches an engine the way a user would bring it there: as the URDF or MJCF
that this package exports.
"""

from abc import ABC, abstractmethod
from importlib.metadata import PackageNotFoundError, version
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.errors import InputError, install_command
from sdp_vs_penalty.exporters.content import Content, about_joints
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


class Engine(ABC):
    """A robot of rigid links inside one engine, without friction, limits or contacts.

    Subclasses set the class attributes and do all importing in :meth:`version` and
    :meth:`load`.
    """

    name: ClassVar[str]
    #: How bodies and joints are described inside, and how time is stepped.
    formulation: ClassVar[str]
    #: The Python package that it comes in.
    package: ClassVar[str] = ""
    #: What to install where it is absent.
    install: ClassVar[str] = install_command("engines")

    def __init__(self, robot: Robot, links: ArrayLike) -> None:
        """Check the links, and load the robot into the engine.

        Parameters
        ----------
        robot : Robot
            Without joints that follow others, which engines do not support here.
        links : (n, 10) array
            Standard parameters of each link [kg, kg m, kg m^2].

        Raises
        ------
        InputError
            For such a robot, or a link that the engine rejects, which is named.
        """
        if robot.mechanism is not None:
            what = "engines take no robot with joints that follow others"
            raise InputError(what, "choose another robot")
        self.robot = robot
        #: (n, 10) about the joint frames.
        self.links = about_joints(robot, np.asarray(links, float).reshape(robot.n, 10))
        for k, (joint, link) in enumerate(
            zip(robot.joints, self.links, strict=True), start=1
        ):
            if link[0] <= 0.0:
                where = f"link {k} (on joint {joint.name!r})"
                raise InputError(
                    "it has no mass, which physics engines refuse", "give it one", where
                )
        self.load()

    @classmethod
    def version(cls) -> str | None:
        """Return the version of the installed engine; None if it is not installed."""
        try:
            return version(cls.package)
        except PackageNotFoundError:
            return None

    @abstractmethod
    def load(self) -> None:
        """Build the robot inside the engine."""

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array | None:
        """Return the torques of N states by the engine's inverse dynamics.

        Positions q [rad, m], velocities dq and accelerations ddq are (N, n).

        Returns
        -------
        (N, n) or None
            [N m, N]; None if the engine has no inverse dynamics.
        """
        states = zip(q, dq, ddq, strict=True)
        torques = [self.torque(*state) for state in states]
        return None if torques[0] is None else np.array(torques, float)

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array | None:
        """Return the torque of one state by the engine's inverse dynamics.

        Positions q [rad, m], velocities dq and accelerations ddq are (n,).

        Returns
        -------
        (n,) or None
            [N m, N]; None, as here, for an engine without inverse dynamics.
        """
        return None

    def follow(
        self, start: Array, velocities: Array, step: float
    ) -> tuple[Array, Array]:
        """Simulate the robot along commanded joint velocities, starting from rest.

        Parameters
        ----------
        start : (n,)
            Positions at the start [rad, m].
        velocities : (N, n)
            Velocity of each step [rad/s, m/s].
        step : float
            Length of a step [s].

        Returns
        -------
        tuple
            The motors' torque (N, n) during each step [N m, N], and the pose (N, 4, 4)
            of the last link's joint frame after it.
        """
        torque = np.empty_like(velocities)
        pose = np.tile(np.eye(4), (len(velocities), 1, 1))
        self.begin(start, step)
        for k, velocity in enumerate(velocities):
            torque[k], pose[k, :3, :3], pose[k, :3, 3] = self.stepped(velocity)
        return torque, pose

    @abstractmethod
    def begin(self, start: Array, step: float) -> None:
        """Put the joints at rest at a position (n,) [rad, m].

        Parameters
        ----------
        step : float
            Length of the steps that follow [s].
        """

    @abstractmethod
    def stepped(self, velocity: Array) -> tuple[Array, Array, Array]:
        """Simulate one step at a commanded velocity (n,) [rad/s, m/s].

        Returns
        -------
        tuple
            The motors' torque (n,) [N m, N], and rotation (3, 3) and position (3,) [m]
            of the last link's joint frame after the step.
        """

    @property
    def content(self) -> Content:
        """The links in the form that the exporters take, without friction and
        effects.
        """
        return Content.of_links(self.robot, self.links)
