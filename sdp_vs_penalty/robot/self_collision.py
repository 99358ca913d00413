"""Whether an arm touches itself, by Pinocchio and coal, where its URDF has collision geometry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.files import LARGEST_TEXT, reading
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.urdf import load_urdf


class SelfCollision:
    """Pairs of links of a URDF that are not neighbours and do not overlap at rest.

    Neighbours, and pairs that touch in every one of a few poses (shapes drawn too large), are left out.
    """

    def __init__(self, model: Any, geometry: Any) -> None:
        self.model, self.geometry = model, geometry
        self.data, self.placed = model.createData(), geometry.createData()

    @classmethod
    def of_urdf(cls, urdf: str | Path, n: int) -> SelfCollision | None:
        """None where the file has no collision shapes that can be read, or other joints than n."""
        path = Path(urdf)
        load_urdf(path)  # says in a sentence what is wrong with the file
        with reading(path, LARGEST_TEXT):
            model = pin.buildModelFromUrdf(str(path))
        try:
            shapes, folders = pin.GeometryType.COLLISION, [str(path.parent)]
            geometry = pin.buildGeomFromUrdf(model, str(path), shapes, package_dirs=folders)
        except (ValueError, RuntimeError):
            return None
        if geometry.ngeoms < 2 or model.nq != n:
            return None
        geometry.addAllCollisionPairs()
        joints = [o.parentJoint for o in geometry.geometryObjects]
        for pair in list(geometry.collisionPairs):
            a, b = joints[pair.first], joints[pair.second]
            if a == b or model.parents[a] == b or model.parents[b] == a:
                geometry.removeCollisionPair(pair)
        out = cls(model, geometry)
        out._leave_out_what_always_touches()
        return out if len(geometry.collisionPairs) else None

    def _leave_out_what_always_touches(self) -> None:
        low = np.maximum(self.model.lowerPositionLimit, -np.pi)
        high = np.minimum(self.model.upperPositionLimit, np.pi)
        pairs, touch = list(self.geometry.collisionPairs), []
        for q in np.random.default_rng(0).uniform(low, high, (40, self.model.nq)):
            pin.computeCollisions(self.model, self.data, self.geometry, self.placed, q, False)
            touch.append([r.isCollision() for r in self.placed.collisionResults])
        for k in np.flatnonzero(np.all(touch, axis=0)):
            self.geometry.removeCollisionPair(pairs[k])
        self.placed = self.geometry.createData()

    def free(self, q: Array) -> bool:
        """Whether no pair touches at any of the poses (N, n)."""
        return not any(
            pin.computeCollisions(self.model, self.data, self.geometry, self.placed, pose, True)
            for pose in q
        )
