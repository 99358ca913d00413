"""MuJoCo's system identification toolbox on filtered rows; runs in an environment of its own.

    python mujoco_identify.py ROWS.npz START.xml OUT.npz

``mujoco.sysid`` (pip install 'mujoco[sysid]') as its documentation says: full inertias by
``InertiaType.Pseudo`` in the default box, damping and dry friction by modifiers of the joints, a torque
offset by ``apply_bias``, residuals normalised as it does by itself, its own optimiser. Its default
fits the motion of a simulation; here its hook ``custom_rollout`` is inverse dynamics, so that it fits
the torque of a log. ROWS.npz holds states on the grid of the columns, the low-pass from there to the
rows, and the torques of the rows (`mujoco_pair.py`).
"""

from __future__ import annotations

import io
import sys
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from scipy import sparse

#: Damping and dry friction [N m s/rad, N m] and offsets [N m]: where they start, and their bounds.
FRICTION = (0.5, 0.0, 20.0)
OFFSET = (0.0, -20.0, 20.0)


def parameters(spec: Any, model: Any) -> Any:
    """Ten of each link, three of each joint."""
    out = sysid.ParameterDict()
    for k in range(1, model.nbody):
        name = model.body(k).name

        def inertia(s: Any, p: Any, name: str = name) -> None:
            sysid.apply_body_inertia(s, name, p)
            # 4.0.0 leaves NaN there, which its own compiler refuses.
            s.body(name).iquat = [1.0, 0.0, 0.0, 0.0]

        kind = sysid.InertiaType.Pseudo
        out.add(sysid.body_inertia_param(spec, model, name, inertia_type=kind, modifier=inertia))
    for k in range(model.njnt):
        for field in ("damping", "frictionloss"):

            def write(s: Any, p: Any, joint: str = model.joint(k).name, field: str = field) -> None:
                target = s.joint(joint)
                if field == "damping":
                    target.damping[0] = p.value[0]
                else:
                    target.frictionloss = p.value[0]

            out.add(sysid.Parameter(f"{field}{k}", *FRICTION, modifier=write))
        out.add(sysid.Parameter(f"offset{k}", *OFFSET))
    return out


def inverse(model: Any, data: Any, q: Any, dq: Any, ddq: Any) -> np.ndarray:
    """(G, n) torque of MuJoCo's inverse dynamics, dry friction and damping included."""
    out = np.empty_like(q)
    position, velocity, acceleration, torque = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
    for k in range(len(q)):
        position[:], velocity[:], acceleration[:] = q[k], dq[k], ddq[k]
        mujoco.mj_inverse(model, data)
        out[k] = torque
    return out


def main(rows: str, start: str, out: str) -> None:
    given = np.load(rows)
    low_pass = sparse.csr_array(
        (given["data"], given["indices"], given["indptr"]), shape=tuple(given["shape"])
    )
    states = given["q"], given["dq"], given["ddq"]
    train, torque = given["train"], given["torque"]
    own = low_pass[train]
    used = np.unique(own.indices)  # of the states, those that rows of training need
    own, known = own[:, used], [x[used] for x in states]

    spec = mujoco.MjSpec.from_file(start)
    off = mujoco.mjtDisableBit
    spec.option.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT
    for k, joint in enumerate(spec.joints):
        spec.add_sensor(
            name=f"torque{k}", type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint.name,
        )  # fmt: skip
    model = spec.compile()
    clock = np.arange(float(train.sum()))
    measured = sysid.TimeSeries.from_names(clock, torque[train], model)
    sequences = sysid.ModelSequences(
        "arm", spec, "run", sysid.create_initial_state(model, known[0][0]),
        sysid.TimeSeries(clock, np.zeros((len(clock), model.nu))), measured,
    )  # fmt: skip

    state = sysid.TimeSeries(clock, clock[:, None])  # it looks for a time there, and at nothing else

    def rollout(models: Any, datas: Any, **rest: Any) -> list[Any]:
        found = []
        for one in models:
            series = sysid.TimeSeries(
                clock, own @ inverse(one, datas[0], *known), rest["rollout_signal_mapping"]
            )
            found.append(sysid.SystemTrajectory(one, series, series, rest["initial_states"][0], state))
        return found

    def modify(params: Any, predicted: Any, measured: Any, model: Any, _: bool, **__: Any) -> Any:
        for k in range(model.njnt):
            predicted = sysid.apply_bias(predicted, f"torque{k}", params[f"offset{k}"])
        error = sysid.weighted_diff(predicted.data, measured.data, model)
        return sysid.normalize_residual(error, measured.data), predicted, measured

    residual = sysid.build_residual_fn(
        models_sequences=[sequences], custom_rollout=rollout, modify_residual=modify,
        n_threads=1, resample_true=False,
    )  # fmt: skip
    said = io.StringIO()
    found, _ = sysid.optimize(
        parameters(spec, model),
        residual,
        verbose=False,
        output=said,
        max_iters=int(given["most"]),
    )
    identified = sysid.apply_param_modifiers(found, spec)
    low, high = found.get_bounds()
    x = found.as_vector()
    links = [sysid.model_modifier.pi_from_theta(found[f"{identified.body(k).name}_inertia"].value)
             for k in range(1, identified.nbody)]  # fmt: skip
    offsets = np.array([found[f"offset{k}"].value[0] for k in range(identified.njnt)])
    predicted = low_pass @ inverse(identified, mujoco.MjData(identified), *states) + offsets
    np.savez(
        out, predicted=predicted, said=said.getvalue(),
        pseudo=np.stack([sysid.model_modifier.pseudoinertia_from_pi(link) for link in links]),
        at_bounds=np.sum((x - low < 1e-6 * (high - low)) | (high - x < 1e-6 * (high - low))),
    )  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
