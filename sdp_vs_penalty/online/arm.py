"""The arm without its payload, instant by instant: torque, and the payload's columns."""

import numpy as np

from sdp_vs_penalty.effects.effect import Effect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.online import constants as c
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

#: Entries of a joint's table over velocity.
_ENTRIES = 8193
#: Velocity below which the entries are evenly spaced, and the largest one [rad/s, m/s].
_FINEST = 1e-5
_FASTEST = 20.0
#: Largest relative error of the tables that represent an effect.
_TOLERANCE = 1e-3


class ArmModel:
    """Torque of a model and the regressor of a payload at one instant, without
    allocation.

    Links come from Pinocchio's regressor. Of the other effects a joint's torque is

        table(dq) + load pull(dq) + |load| rub(dq) + stiffness q + armature ddq,

    with three tables over the joint's velocity, finer near zero. ``load`` is the torque
    on the joint of the model's reference links, those at which friction by load was
    identified. Tables and slopes are read off the effects' own torque; between the
    entries of a table it is interpolated, to some 1e-6 of the effect's torque.

    - ``torque`` (n,): that of the last instant, as the channels read it.
    - ``friction`` (n,): the part of it that follows velocity.
    - ``columns`` (n, 10): the payload's, in the last link's frame.
    - ``dry_friction`` (n,): half the jump of friction where a joint turns round, under
      its mean load by gravity.
    """

    def __init__(self, model: Model, theta: Array) -> None:
        """Tabulate the effects of the arm's model (parameters theta (p,)) for the
        control loop.

        A joint turns round between -REST_SPEED and REST_SPEED. Raises InputError for a
        model without links, and for an effect that does not run in the loop.
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
                self._tabulate(effect, self.theta[indices])
        self.dry_friction = self._jump_at_reversal()

    def _jump_at_reversal(self) -> Array:
        """Return half the jump of friction (n,) where a joint turns round, under its
        mean load by gravity."""
        still = np.zeros((100, self.n))
        poses = self.model.robot.random_configurations(len(still), 0)
        gravity = self.model.robot.inverse_dynamics(
            self._reference, poses, still, still
        )
        self._load[:] = np.abs(gravity).mean(axis=0)
        forwards = np.zeros(self.n)
        backwards = np.zeros(self.n)
        self._add_friction(self._tables, np.full(self.n, c.REST_SPEED), forwards)
        self._add_friction(self._tables, np.full(self.n, -c.REST_SPEED), backwards)
        return 0.5 * self._gains * np.abs(forwards - backwards)

    def _place_links(self, robot: Robot) -> None:
        """Put the links' parameters where Pinocchio's regressor expects them.

        - ``_tree_links`` (10 joints of the tree,): their parameters there.
        - ``_last``: columns of the last link, which carries the payload.
        - ``_map`` (10, 10): from the link's frame to the joint's.
        - ``_reference`` (links, 10), ``_tree_reference``: the links to whose torque
          friction by load refers.
        """
        self._regressor = robot._pin.computeJointTorqueRegressor
        self._pinocchio = robot._model
        self._data = robot._model.createData()
        maps = robot._link_maps
        self._map = np.eye(10) if maps is None else np.ascontiguousarray(maps[-1])
        links = self.theta[self.model.rigid_indices].reshape(-1, 10)
        self._tree_links = self._on_tree(links)
        self._reference = links
        if self.model.reference is not None:
            reference = self.model.reference[self.model.rigid_indices]
            self._reference = reference.reshape(-1, 10)
        self._tree_reference = self._on_tree(self._reference)
        first = 10 * robot.link_joints[-1]
        self._last = slice(first, first + 10)

    def _on_tree(self, links: Array) -> Array:
        """Return parameters of links (links, 10) about their own frames as those of
        the tree's joints (10 joints of the tree,)."""
        robot = self.model.robot
        if robot._link_maps is not None:
            links = np.einsum("kij,kj->ki", robot._link_maps, links)
        tree = np.zeros((len(robot.tree), 10))
        tree[list(robot.link_joints)] = links
        return tree.ravel()

    def _allocate(self, n_tree: int) -> None:
        """Allocate the arrays of an update, for n joints and ``n_tree`` joints of the
        tree.

        Each joint has three tables over velocity with _ENTRIES values: torque without
        load, per unit of load, and per unit of its size. The velocities are evenly
        spaced in arcsinh: finer near zero, where friction jumps.
        """
        n = self.n
        # Entries a unit of arcsinh(velocity / _FINEST), from -_FASTEST to _FASTEST.
        self._scale = (_ENTRIES - 1) / (2.0 * np.arcsinh(_FASTEST / _FINEST))
        self._tables = [np.zeros(n * _ENTRIES) for _ in range(3)]
        self._has_load = False
        self._first = _ENTRIES * np.arange(n)  # of each joint's table
        self._index = np.zeros(n, np.intp)
        self._place = np.zeros(n)
        self._low = np.zeros(n)
        self._high = np.zeros(n)
        self._stiffness = np.zeros(n)
        self._armature = np.zeros(n)
        self._part = np.zeros(n)
        self._load = np.zeros(n)
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
        self._to_driven_joints(self._tree_torque, self.torque)
        self._to_driven_joints(self._tree_columns, self.columns)
        if self._has_load:
            np.dot(regressor, self._tree_reference, out=self._tree_torque)
            self._to_driven_joints(self._tree_torque, self._load)
        self.friction[:] = 0.0
        self._add_friction(self._tables, dq, self.friction)
        self.torque += self.friction
        self.friction *= self._gains
        np.multiply(self._stiffness, q, out=self._part)
        self.torque += self._part
        np.multiply(self._armature, ddq, out=self._part)
        self.torque += self._part
        self.torque *= self._gains
        self.columns *= self._gain_column

    def _to_driven_joints(self, of_tree: Array, out: Array) -> None:
        """Project torques or columns of the joints of the tree (joints, ...) onto the n
        driven joints, into ``out`` (n, ...)."""
        if self._mechanism is None:
            np.copyto(out, of_tree)
        else:
            np.dot(self._mechanism.matrix.T, of_tree, out=out)

    def _add_friction(self, tables: list[Array], dq: Array, torque: Array) -> None:
        """Add the friction of three tables at velocities dq (n,), under the joints'
        load, to ``torque`` (n,), without allocation."""
        without_load, pull, rub = tables
        self._find_place(dq)
        self._read(without_load)
        torque += self._low
        if not self._has_load:
            return
        self._read(pull)
        self._low *= self._load
        torque += self._low
        self._read(rub)
        np.absolute(self._load, out=self._part)
        self._low *= self._part
        torque += self._low

    def _find_place(self, dq: Array) -> None:
        """Find the places of velocities dq (n,) in the tables: ``_index`` (n,) of the
        entry below, and ``_place`` (n,), the share of the way to the next one."""
        place = self._place
        np.divide(dq, _FINEST, out=place)
        np.arcsinh(place, out=place)
        place *= self._scale
        place += 0.5 * (_ENTRIES - 1)
        # Below the last entry, so that the next one exists.
        np.clip(place, 0.0, _ENTRIES - 1.001, out=place)
        np.copyto(self._index, place, casting="unsafe")
        place -= self._index
        self._index += self._first  # the joints' tables stand end to end

    def _read(self, table: Array) -> None:
        """Interpolate a table linearly at the velocities of :meth:`_find_place`; the result
        (n,) is in ``_low``, so that nothing is allocated."""
        np.take(table, self._index, out=self._low, mode="clip")
        self._index += 1
        np.take(table, self._index, out=self._high, mode="clip")
        self._index -= 1
        self._high -= self._low
        self._high *= self._place
        self._low += self._high

    def _tabulate(self, effect: Effect, theta: Array) -> None:
        """Add an effect with parameters theta (k,) to the tables and slopes of the loop.

        They are read off the effect's own torque. Raises InputError unless they
        reproduce that torque at random states to _TOLERANCE.
        """
        # 400 random states and loads (400, n) for the check below.
        rng = np.random.default_rng(0)
        q, dq, ddq, load = rng.uniform(-1.0, 1.0, (4, 400, self.n))
        try:
            exact = self._torque(effect, theta, q, dq, ddq, load)
            tables = self._tables_of(effect, theta)
            stiffness, armature = self._slopes_of(effect, theta)
        except (ValueError, AttributeError, AssertionError) as error:
            raise self._refusal(effect) from error
        _, pull, rub = tables
        self._has_load |= bool(pull.any() or rub.any())
        approximate = stiffness * q + armature * ddq
        for k, velocities in enumerate(dq):
            self._load[:] = load[k]
            self._add_friction(tables, velocities, approximate[k])
        size = np.abs(exact).max(initial=1e-12)
        if not np.allclose(approximate, exact, rtol=0.0, atol=_TOLERANCE * size):
            raise self._refusal(effect)
        for table, of_effect in zip(self._tables, tables, strict=True):
            table += of_effect
        self._stiffness = self._stiffness + stiffness
        self._armature = self._armature + armature

    def _tables_of(self, effect: Effect, theta: Array) -> list[Array]:
        """Return an effect's tables over velocity (n entries,), joint after joint: torque
        without load, pull and rub. Under a load it is table + load pull + |load| rub."""
        place = np.arange(_ENTRIES, dtype=float) - (_ENTRIES - 1) / 2
        # The velocities of the tables [rad/s, m/s], fine near zero.
        nodes = (_FINEST * np.sinh(place / self._scale))[:, None] * np.ones(self.n)
        still = np.zeros_like(nodes)
        # Under no load, and under a unit of it either way.
        without, forth, back = (
            self._torque(effect, theta, still, nodes, still, still + unit)
            for unit in (0.0, 1.0, -1.0)
        )
        pull = 0.5 * (forth - back)
        rub = 0.5 * (forth + back) - without
        return [table.T.ravel() for table in (without, pull, rub)]

    def _slopes_of(self, effect: Effect, theta: Array) -> tuple[Array, Array]:
        """Return by how much an effect's torque grows with position and acceleration, both
        (n,): the torque of a unit of each, less that of zero state."""
        one = np.ones((1, self.n))
        zero = np.zeros((1, self.n))
        constant = self._torque(effect, theta, zero, zero, zero, zero)[0]
        by_position = self._torque(effect, theta, one, zero, zero, zero)[0]
        by_acceleration = self._torque(effect, theta, zero, zero, one, zero)[0]
        return by_position - constant, by_acceleration - constant

    def _refusal(self, effect: Effect) -> InputError:
        """Return the InputError for an effect that cannot run in the control loop."""
        return InputError(
            f"effect {effect.name} cannot run in the loop: it needs more than one"
            " joint's state and load at one instant",
            "make a model without it (`add --only` the other findings), or let `export`"
            " write a model.h, which says at its top whether C holds it",
        )

    def _torque(
        self, effect: Effect, theta: Array, q: Array, dq: Array, ddq: Array, load: Array
    ) -> Array:
        """Return the torque (N, n) of one effect at N independent states (N, n), under
        a load (N, n) of the joints.

        theta (k,) are the effect's parameters. An effect that needs more (such as a
        temperature) may raise an error.
        """
        # The states are unrelated: their instants [s] have no meaning.
        clock = 1e-3 * np.arange(len(q), dtype=float)
        motion = Motion(clock, q, dq, ddq, sign_width=self.model.sign_width)
        return effect.torque(theta, motion.with_link_torque(load))
