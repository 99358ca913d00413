"""MuJoCo's system identification on given rows, in an environment of its own.

    python mujoco_script.py ROWS.npz START.xml OUT.npz

`mujoco.sysid` as its documentation says: full inertias by `InertiaType.Pseudo` in the
default box, damping and dry friction by modifiers of the joints, a torque offset by
`apply_bias`, normalised residuals, its own optimiser. Its default fits the motion of a
simulation; here its hook `custom_rollout` is inverse dynamics, so that it fits the torque
of a log.
"""

import io
import sys
from functools import partial
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid

#: Start and bounds of damping [N m s/rad] and dry friction [N m], and of offsets [N m].
FRICTION = (0.5, 0.0, 20.0)
OFFSET = (0.0, -20.0, 20.0)
#: Gauss-Newton steps, of its default 200.
STEPS = 40


def write_inertia(spec: Any, parameter: Any, name: str) -> None:
    """Write the inertia of one body."""
    sysid.apply_body_inertia(spec, name, parameter)
    # 4.0.0 leaves NaN there, which its own compiler refuses.
    spec.body(name).iquat = [1.0, 0.0, 0.0, 0.0]


def write_damping(spec: Any, parameter: Any, joint: str) -> None:
    """Write the damping of one joint."""
    spec.joint(joint).damping[0] = parameter.value[0]


def write_friction(spec: Any, parameter: Any, joint: str) -> None:
    """Write the dry friction of one joint."""
    spec.joint(joint).frictionloss = parameter.value[0]


def parameters(spec: Any, model: Any) -> Any:
    """Ten parameters for each link, three for each joint."""
    out = sysid.ParameterDict()
    for k in range(1, model.nbody):
        name = model.body(k).name
        out.add(
            sysid.body_inertia_param(
                spec,
                model,
                name,
                inertia_type=sysid.InertiaType.Pseudo,
                modifier=partial(write_inertia, name=name),
            )
        )
    for k in range(model.njnt):
        joint = model.joint(k).name
        damping = partial(write_damping, joint=joint)
        friction = partial(write_friction, joint=joint)
        out.add(sysid.Parameter(f"damping{k}", *FRICTION, modifier=damping))
        out.add(sysid.Parameter(f"frictionloss{k}", *FRICTION, modifier=friction))
        out.add(sysid.Parameter(f"offset{k}", *OFFSET))
    return out


def inverse(model: Any, data: Any, q: Any, dq: Any, ddq: Any) -> np.ndarray:
    """Torque (M, n) of MuJoCo's inverse dynamics, with dry friction and damping."""
    torque = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:] = q[k]
        data.qvel[:] = dq[k]
        data.qacc[:] = ddq[k]
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return torque


def read_arm(start: str) -> Any:
    """Read the arm, without contacts and limits, with a sensor of each joint's torque."""
    spec = mujoco.MjSpec.from_file(start)
    off = mujoco.mjtDisableBit
    spec.option.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT
    for k, joint in enumerate(spec.joints):
        spec.add_sensor(
            name=f"torque{k}",
            type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
        )
    return spec


def main(rows_file: str, start: str, out: str) -> None:
    """Fit the training rows, and predict the torque of the judged ones."""
    rows = np.load(rows_file)
    train = [rows[f"train_{name}"] for name in ("q", "dq", "ddq")]
    judged = [rows[f"judged_{name}"] for name in ("q", "dq", "ddq")]
    torque = rows["train_tau"]
    spec = read_arm(start)
    model = spec.compile()
    clock = np.arange(float(len(torque)))
    sequences = sysid.ModelSequences(
        "arm",
        spec,
        "run",
        sysid.create_initial_state(model, train[0][0]),
        sysid.TimeSeries(clock, np.zeros((len(clock), model.nu))),
        sysid.TimeSeries.from_names(clock, torque, model),
    )
    # It looks for a time there, and at nothing else.
    state = sysid.TimeSeries(clock, clock[:, None])

    def rollout(models: Any, datas: Any, **others: Any) -> list[Any]:
        trajectories = []
        for one in models:
            mapping = others["rollout_signal_mapping"]
            series = sysid.TimeSeries(clock, inverse(one, datas[0], *train), mapping)
            first = others["initial_states"][0]
            trajectories.append(
                sysid.SystemTrajectory(one, series, series, first, state)
            )
        return trajectories

    def modify(
        params: Any, predicted: Any, measured: Any, model: Any, _: bool, **__: Any
    ) -> Any:
        for k in range(model.njnt):
            predicted = sysid.apply_bias(predicted, f"torque{k}", params[f"offset{k}"])
        error = sysid.weighted_diff(predicted.data, measured.data, model)
        return (sysid.normalize_residual(error, measured.data), predicted, measured)

    residual = sysid.build_residual_fn(
        models_sequences=[sequences],
        custom_rollout=rollout,
        modify_residual=modify,
        n_threads=1,
        resample_true=False,
    )
    optimum, _ = sysid.optimize(
        parameters(spec, model),
        residual,
        verbose=False,
        output=io.StringIO(),
        max_iters=STEPS,
    )
    identified = sysid.apply_param_modifiers(optimum, spec)
    offsets = [optimum[f"offset{k}"].value[0] for k in range(identified.njnt)]
    predicted = inverse(identified, mujoco.MjData(identified), *judged)
    np.savez(out, predicted=predicted + np.array(offsets))


if __name__ == "__main__":
    main(*sys.argv[1:])
