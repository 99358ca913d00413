"""The arm without its payload, instant by instant: torque, and the payload's columns."""

import numpy as np

from sdp_vs_penalty.effects.effect import Effect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.online import constants as c
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

#: Entries of a table of one effect over velocity, its finest step [rad/s, m/s] and its
#: largest velocity.
_ENTRIES = 8193
_FINEST = 1e-5
_FASTEST = 20.0
#: Relative error of a table that is taken for the effect itself.
_TOLERANCE = 1e-3


class ArmModel:
    """Torque of a model and the regressor of a payload at one instant, without
    allocation.

    Links come from Pinocchio's regressor. Effects that follow one joint's velocity are
    tabulated over it, finer near zero; those that grow with a joint's position or
    acceleration are slopes. Which is which is read off the effects' own torque.

    ``torque`` (n,) is that of the last instant, as the channels read it, ``friction``
    (n,) the part of it that follows velocity, ``columns`` (n, 10) those of the payload,
    in the last link's frame, and ``dry_friction`` (n,) half the jump of friction where
    a joint turns round.
    """

    def __init__(self, model: Model, theta: Array) -> None:
        """Tabulate the effects of the arm's model (parameters theta (p,)) for the
        control loop.

        The links' torque comes from Pinocchio; friction and other effects from tables
        over the velocity. A joint turns round between -REST_SPEED and REST_SPEED.
        Raises InputError for a model without links, and for an effect that does not run
        in the loop.
        """
        if not len(model.rigid_indices):
            raise InputError("the model has no rigid body", "identify one with links")
        robot = model.robot
        self.model = model
        self.theta = np.array(theta, float)
        self.n = robot.n
        self._mechanism = robot.mechanism
        self._gains = np.ones(robot.n)
        if model.gains is not None:
            self._gains = np.array(model.gains)
        self._gain_column = np.ascontiguousarray(self._gains[:, None])
        self._place_links(robot)
        self._allocate(len(robot.tree))
        for effect, indices in model.parts:
            if not np.array_equal(indices, model.rigid_indices):
                self._take(effect, self.theta[indices])
        forwards = np.zeros(robot.n)
        backwards = np.zeros(robot.n)
        self._add_table(np.full(robot.n, c.REST_SPEED), forwards)
        self._add_table(np.full(robot.n, -c.REST_SPEED), backwards)
        self.dry_friction = 0.5 * self._gains * np.abs(forwards - backwards)

    def _place_links(self, robot: Robot) -> None:
        """Put the links' parameters where Pinocchio's regressor expects them.

        Sets ``_tree_links`` (10 joints of the tree,), the columns ``_last`` of the
        payload (the last link), and ``_map`` (10, 10) from link-frame to joint-frame
        parameters.
        """
        self._regressor = robot._pin.computeJointTorqueRegressor
        self._pinocchio = robot._model
        self._data = robot._model.createData()
        links = self.theta[self.model.rigid_indices].reshape(-1, 10)
        maps = robot._link_maps
        self._map = np.eye(10)
        if maps is not None:
            links = np.einsum("kij,kj->ki", maps, links)
            self._map = np.ascontiguousarray(maps[-1])
        tree = np.zeros((len(robot.tree), 10))
        tree[list(robot.link_joints)] = links
        self._tree_links = tree.ravel()
        first = 10 * robot.link_joints[-1]
        self._last = slice(first, first + 10)

    def _allocate(self, n_tree: int) -> None:
        """Allocate the arrays of an update, for n joints and ``n_tree`` joints of the
        tree.

        Each joint has a table of torque over velocity with _ENTRIES values, at
        velocities that are evenly spaced in arcsinh: finer near zero, where friction
        jumps.
        """
        n = self.n
        # Entries a unit of arcsinh(velocity / _FINEST), from -_FASTEST to _FASTEST.
        self._scale = (_ENTRIES - 1) / (2.0 * np.arcsinh(_FASTEST / _FINEST))
        self._table = np.zeros(n * _ENTRIES)
        self._first = _ENTRIES * np.arange(n)  # of each joint's table
        self._index = np.zeros(n, np.intp)
        self._place = np.zeros(n)
        self._low = np.zeros(n)
        self._high = np.zeros(n)
        self._stiffness = np.zeros(n)
        self._armature = np.zeros(n)
        self._part = np.zeros(n)
        self.torque = np.zeros(n)
        self.friction = np.zeros(n)
        self.columns = np.zeros((n, 10))
        self._tree_torque = np.zeros(n_tree)
        self._tree_columns = np.zeros((n_tree, 10))

    def update(self, q: Array, dq: Array, ddq: Array) -> None:
        """Compute torque and payload columns of one instant.

        Positions q [rad, m], velocities dq and accelerations ddq are (n,).

        Returns
        -------
        None
            ``torque`` (n,), ``friction`` (n,) and ``columns`` (n, 10) hold the result.
        """
        # Joints that follow others (a mechanism) move linearly with the n joints.
        tree_q = q
        tree_dq = dq
        tree_ddq = ddq
        if self._mechanism is not None:
            follow = self._mechanism.matrix
            tree_q = follow @ q + self._mechanism.offset
            tree_dq = follow @ dq
            tree_ddq = follow @ ddq
        regressor = self._regressor(
            self._pinocchio, self._data, tree_q, tree_dq, tree_ddq
        )
        np.dot(regressor, self._tree_links, out=self._tree_torque)
        np.dot(regressor[:, self._last], self._map, out=self._tree_columns)
        if self._mechanism is None:
            np.copyto(self.torque, self._tree_torque)
            np.copyto(self.columns, self._tree_columns)
        else:
            np.dot(self._mechanism.matrix.T, self._tree_torque, out=self.torque)
            np.dot(self._mechanism.matrix.T, self._tree_columns, out=self.columns)
        self.friction[:] = 0.0
        self._add_table(dq, self.friction)
        self.torque += self.friction
        self.friction *= self._gains
        np.multiply(self._stiffness, q, out=self._part)
        self.torque += self._part
        np.multiply(self._armature, ddq, out=self._part)
        self.torque += self._part
        self.torque *= self._gains
        self.columns *= self._gain_column

    def _add_table(self, dq: Array, torque: Array) -> None:
        """Add the tabulated torque at velocities dq (n,) to ``torque`` (n,), without
        allocation.

        Linear interpolation between entries: ``place`` is a fractional index into the
        table, evenly spaced in arcsinh of the velocity.
        """
        place = self._place
        low = self._low
        high = self._high
        np.divide(dq, _FINEST, out=place)
        np.arcsinh(place, out=place)
        place *= self._scale
        place += 0.5 * (_ENTRIES - 1)
        # Below the last entry, so that the next one exists.
        np.clip(place, 0.0, _ENTRIES - 1.001, out=place)
        np.copyto(self._index, place, casting="unsafe")
        place -= self._index  # now the share of the way to the next entry
        self._index += self._first  # the joints' tables stand end to end
        np.take(self._table, self._index, out=low, mode="clip")
        self._index += 1
        np.take(self._table, self._index, out=high, mode="clip")
        high -= low
        high *= place
        torque += low
        torque += high

    def _take(self, effect: Effect, theta: Array) -> None:
        """Represent an effect in the control loop: torque(dq) + stiffness q + armature
        ddq.

        The table torque(dq) and the slopes are read off the effect's own torque; theta
        (k,) are its parameters. All effects are added up in one table. Raises
        InputError unless they reproduce the effect's torque at random states to
        _TOLERANCE.
        """
        # 400 random states (400, n), on which table and slopes are checked below.
        rng = np.random.default_rng(0)
        q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 400, self.n))
        try:
            exact = self._torque(effect, theta, q, dq, ddq)
            # Torque over velocity, joint after joint (n entries,).
            nodes = self._nodes()[:, None] * np.ones(self.n)
            still = np.zeros_like(nodes)
            table = self._torque(effect, theta, still, nodes, still).T.ravel()
            # Torque of unit position and unit acceleration, less that of zero state.
            one = np.ones((1, self.n))
            zero = np.zeros((1, self.n))
            constant = self._torque(effect, theta, zero, zero, zero)[0]
            stiffness = self._torque(effect, theta, one, zero, zero)[0] - constant
            armature = self._torque(effect, theta, zero, zero, one)[0] - constant
        except (ValueError, AttributeError, AssertionError) as error:
            raise self._refusal(effect) from error
        # The effect's table alone, to compare it with the effect.
        previous_table = self._table
        self._table = table
        approximate = stiffness * q + armature * ddq
        for row, velocities in zip(approximate, dq, strict=True):
            self._add_table(velocities, row)
        self._table = previous_table
        size = np.abs(exact).max(initial=1e-12)
        if not np.allclose(approximate, exact, rtol=0.0, atol=_TOLERANCE * size):
            raise self._refusal(effect)
        self._table = self._table + table
        self._stiffness = self._stiffness + stiffness
        self._armature = self._armature + armature

    def _refusal(self, effect: Effect) -> InputError:
        """Return the InputError for an effect that cannot run in the control loop."""
        return InputError(
            f"effect {effect.name} cannot run in the loop: it needs more than the"
            " velocity of one joint at one instant",
            "identify the arm without it for this purpose",
        )

    def _nodes(self) -> Array:
        """Return the velocities (entries,) of the table [rad/s, m/s], fine near zero."""
        place = np.arange(_ENTRIES, dtype=float) - (_ENTRIES - 1) / 2
        return np.asarray(_FINEST * np.sinh(place / self._scale), float)

    def _torque(
        self, effect: Effect, theta: Array, q: Array, dq: Array, ddq: Array
    ) -> Array:
        """Return the torque (N, n) of one effect at N independent states (N, n).

        theta (k,) are the effect's parameters. An effect that needs more than the
        states (such as a temperature) may raise an error.
        """
        # The states are unrelated: their instants [s] have no meaning.
        clock = 1e-3 * np.arange(len(q), dtype=float)
        motion = Motion(clock, q, dq, ddq, sign_width=self.model.sign_width)
        return effect.torque(theta, motion)
