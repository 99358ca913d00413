"""Hobby arms without torque by `identify` and by MuJoCo's own system identification.

    python benchmarks/against_sysid.py [--seeds 11:17]

Needs `mujoco[sysid]`. Arms, servos and commands are those of docs/hobby-arm.md, drawn anew for each
seed. What `check` repairs (rows at an end stop) is repaired for `identify`, as `check --fix` does.
Both start from the maker's URDF and are told one gain; both are judged by how far MuJoCo, with what they
found, is from the arm's encoders on a command that neither has seen. sysid has masses, centres of mass,
rotors, dry friction and gains to find, by rollouts of 2 ms.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
from mujoco import sysid

from sdp_vs_penalty import check, export, identify
from sdp_vs_penalty.data.measurements import Measurements

PAGE = Path(__file__).parents[1] / "docs" / "hobby-arm.md"
SIZE, NONE = np.array([1.0, 1.0, 0.8, 0.3, 0.25, 0.2]), np.zeros((6, 3))
T = np.arange(0.0, 20.0, 0.01)


def page_names() -> dict[str, Any]:
    """What the page's script defines, without the arm that it makes."""
    (script, *_) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(script.partition("rng, size =")[0], names)  # our own page
    return names


def by_sysid(urdf: str, told: np.ndarray, q: np.ndarray, kp2: float) -> mujoco.MjModel:
    """The arm as mujoco.sysid finds it, from the maker's."""
    spec = mujoco.MjSpec.from_string(urdf)
    spec.option.timestep, spec.option.integrator = 2e-3, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for k, joint in enumerate(spec.joints):
        servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=kp2 if k == 1 else 7.0 * SIZE[k], kv=0.4 * SIZE[k])
        joint.armature, joint.frictionloss = 3e-3 * SIZE[k], 0.02 * SIZE[k]
        joint.solref_friction = [4e-3, 1.0]
        sensor = mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtObj.mjOBJ_JOINT
        spec.add_sensor(name=f"p{k}", type=sensor[0], objtype=sensor[1], objname=joint.name)
    model, wanted = spec.compile(), sysid.ParameterDict()
    near = {"scale_rot_inertia": True, "ipos_bound_off": np.array([-0.03, 0.03])}

    def add(name: str, value: float, low: float, high: float, change: Any) -> None:
        wanted.add(sysid.Parameter(name, value, low, high, modifier=lambda s, p: change(s, p.value[0])))

    for k, joint in enumerate(spec.joints):
        n, s = joint.name, float(SIZE[k])
        wanted.add(
            sysid.body_inertia_param(spec, model, f"l{k + 1}", sysid.InertiaType.MassIpos, **near)
        )
        for what, value, high in (("armature", 3e-3, 0.03), ("frictionloss", 0.02, 0.3)):
            change = lambda spec, x, n=n, what=what: setattr(spec.joint(n), what, x)  # noqa: E731
            add(f"{n} {what}", value * s, 1e-6, high * s, change)
        if k != 1:
            add(f"{n} kp", 7.0 * s, s, 20.0 * s, lambda spec, x, n=n: sysid.apply_pgain(spec, n, x))
        add(f"{n} kv", 0.4 * s, 0.01 * s, 3.0 * s, lambda spec, x, n=n: sysid.apply_dgain(spec, n, x))
    data, fine = mujoco.MjData(model), np.arange(0.0, T[-1], 2e-3)
    data.qpos[:] = told[0]
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    control = sysid.TimeSeries(fine, np.column_stack([np.interp(fine, T, x) for x in told.T]))
    seen = sysid.TimeSeries.from_names(T, q, model)
    runs = sysid.ModelSequences("hobby", spec, "run", start, control, seen)
    with contextlib.redirect_stdout(io.StringIO()):
        residual = sysid.build_residual_fn(models_sequences=[runs])
        best, _ = sysid.optimize(wanted, residual, optimizer="mujoco", verbose=False, max_iters=60)
    sysid.apply_param_modifiers_spec(best, spec)
    return spec.compile()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", default="11:17", help="first:stop")
    warnings.simplefilter("ignore")
    own = page_names()
    urdf, servos, mass, count = (own[name] for name in ("urdf", "servos", "MASS", "COUNT"))
    maker = urdf(mass, NONE)
    for seed in range(*map(int, parser.parse_args().seeds.split(":"))):
        rng = np.random.default_rng(seed)
        links = mass * rng.uniform(0.8, 1.5, 6), rng.uniform(-0.012, 0.012, (6, 3))
        kp, kv = SIZE * rng.uniform(6.0, 9.0, 6), SIZE * rng.uniform(0.35, 0.6, 6)
        lost = {"armature": 0.006 * SIZE, "damping": 0.03 * SIZE, "friction": 0.05 * SIZE}
        real, told = (
            servos(urdf(*links), kp, kv, **lost),
            [own["command"](10 * seed + k, T) for k in (0, 1)],
        )
        q, unseen = (count * np.round(own["follow"](real, T, x) / count) for x in told)
        with tempfile.TemporaryDirectory() as folder:
            file, made = Path(folder, "hobby.urdf"), Path(folder, "servo.xml")
            file.write_text(maker)
            run, begin = Measurements.of(T, {"q": q, "qcmd": told[0]}, ("run",)), time.process_time()
            run = check(str(file), run, thorough=False)[0].fixed
            found = identify(str(file), run, known={"kp2": kp[1]}, check=False)
            ours = time.process_time() - begin
            export(found, made)
            models = {"identify": mujoco.MjModel.from_xml_path(str(made))}
        begin = time.process_time()
        models["sysid"] = by_sysid(maker, told[0], q, kp[1])
        theirs = time.process_time() - begin
        models["given"] = servos(maker, 7.0 * SIZE, 0.4 * SIZE)
        off = {
            k: np.sqrt(np.mean((own["follow"](m, T, told[1]) - unseen) ** 2)) for k, m in models.items()
        }
        said = ", ".join(f"{name} {1e3 * x:.2f}" for name, x in off.items())
        print(f"{seed}: {said} mrad on unseen motion; CPU {ours:.1f} and {theirs:.0f} s", flush=True)


if __name__ == "__main__":
    main()
