"""Small logs, and what identification and diagnosis make of them."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from arms import THREE, run_of_widths, scara, write_urdf
from challenge.worlds.conditions import Conditions, SensorNoise
from challenge.worlds.runs import draw_motion, draw_world, log_run, urdf_of
from random_robots import repeating_run
from servo_log import EFFECTS as LOOP
from servo_log import log, write_slide
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import concatenate
from sdp_vs_penalty.diagnosis import diagnosis_rows, list_candidates, whiten_rows
from sdp_vs_penalty.effects import JointCoverage, effect_types
from sdp_vs_penalty.estimation import bootstrap, excitation, separation
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs
from sdp_vs_penalty.testing.effects import (
    robots,
    steady_motion,
    to_and_fro,
    variants,
    wide_columns,
)

#: Of an estimate's provenance, what changes from day to day.
PASSING = "versions", "data_hash"


def model(estimate: sdp.Estimate) -> dict[str, Any]:
    """What model.json holds but for what was put in, and a band of torques."""
    text = json.dumps(estimate.to_dict())
    said = json.loads(text.replace(str(estimate.provenance["data_hash"]), "log"))
    motion = steady_motion(estimate.robot)
    torque, std = estimate.uncertainty.band(
        estimate.theta, estimate.model.columns(motion)
    )
    provenance = {k: v for k, v in said["provenance"].items() if k not in PASSING}
    kept = {
        k: said[k]
        for k in ("parameters", "certificate", "effects", "preprocessing", "details")
    }
    base = said["uncertainty"]["base"]
    return {
        **kept,
        "base": base,
        "provenance": provenance,
        "band": [torque[::20], std[::20]],
    }


def two_link_with(
    tau: Callable[[sdp.Measurements], Any], seconds: float = 24.0
) -> sdp.Measurements:
    run = repeating_run(sdp.load_problem("two_link"), 0, noise=0.05, seconds=seconds)
    return replace(run, tau=run.tau + tau(run))


def effects_of(which: str) -> dict[str, Any]:
    """Of each effect how it is searched, what it makes of a motion, and what is said of
    it."""
    robot = robots()[which]
    out = {}
    moved = to_and_fro(robot)
    for name in effect_types():
        every = variants(effect_types()[name], robot)
        first = every[0]
        few = every[:: 1 + len(every) // 9]
        seen = [
            JointCoverage(),
            JointCoverage(0.5, 0.01, 0.5),
            JointCoverage(5.0, 1e-4, 0.01),
        ]
        out[name] = {
            "texts": [e.text for e in every],
            "shapes": {
                k: [s.default, s.grid, s.bounds] for k, s in first.shapes.items()
            },
            "plausible": first.plausible,
            "nominal": first.nominal,
            "limits": [
                [c.name, c.constant]
                for c in first.constraints(np.arange(len(first.nominal)))
            ],
            "columns": [np.abs(wide_columns(e, moved)).mean(axis=(1, 2)) for e in few],
            "ends": np.sum(wide_columns(first, moved)[:, [7, -7]], axis=2),
            "said": [
                first.constants,
                first.brief,
                first.remark(0.3),
                first.as_sized(0.1),
            ]
            + [first.looks_like(size, s) for size in (0.01, 2.0) for s in seen],
            "undone": first.invert_channel(
                np.full(len(first.nominal), 0.02), moved.t, moved.torque
            )[[50, 300]],
        }
    return out


def identified(folder: Path) -> dict[str, Any]:
    two = sdp.load_problem("two_link")
    run = two_link_with(lambda r: 0.0)
    heard = list[str]()
    plain = sdp.identify(two, run)
    told = {"effects": "rigid_body", "progress": heard.append}
    problem = sdp.load_problem(scara(folder))
    widths = run_of_widths(problem, (0.02, 0.003, 0.001, 0.08), 12.0)
    return {
        "two_link": model(plain),
        "gains": model(sdp.identify(two, run, "ols", gain_uncertainty=0.02)),
        "widths": model(sdp.identify(problem, widths, "ols", check=False)),
        "drawn": bootstrap(two, run, 2).to_numpy(),
        "folds": sdp.cross_validate(
            two, run, "ols", folds=3, progress=heard.append
        ).to_dict(),
        "simulated": model(
            sdp.identify(two, run.window(0.0, 4.0), "output-error", **told, check=False)
        ),
        "heard": heard,
    }


def of_servos(folder: Path) -> dict[str, Any]:
    arm = write_slide(folder)
    run = log(1e-4, ki=700.0, delay=0.02, torque=True)
    heard = list[str]()
    noise = 20.0 * np.random.default_rng(3).normal(
        size=run.tau.shape
    )  # a part that no loop makes
    noisy = replace(run, tau=run.tau + noise)
    beside = sdp.identify(
        arm, noisy, effects=f"{LOOP},servo_position,servo_integral", check=False
    )
    silent = sdp.Measurements.of(
        run.t, {"q": run.q, "qcmd": run.commanded["qcmd"]}, ("run",)
    )
    found = sdp.identify(
        arm, silent, effects=LOOP, known={"m1": 3.0}, progress=heard.append
    )
    loads = [(log(1e-4, seed=5, load=1.5), 1.5)]
    loaded = sdp.identify(
        arm, log(1e-4), effects=LOOP, known_loads=loads, instruments="none"
    )
    open_ = sdp.identify(arm, log(1e-4, kh=50.0, ki=500.0))
    return {
        "beside": beside.details,
        "silent": model(found),
        "loaded": model(loaded),
        "open": model(open_),
        "followed": sdp.follow(found, log(seed=3).window(0.0, 2.0), drive="servo")
        .free[0]
        .rms,
        "compared": sdp.compare(found, silent)[0].to_dict(),
        "heard": heard,
    }


def of_loads(folder: Path) -> dict[str, Any]:
    problem = sdp.load_problem(write_urdf(folder / "arm.urdf", "arm", THREE))
    run = small_run(problem, 16.0, 0)
    heavy = small_run(problem, 16.0, 1)
    links = np.zeros((3, 10))
    links[-1] = 1.5 * np.array([1.0, 0.05, -0.02, 0.1, 0.013, 0, 0.013, 0, 0, 0.005])
    t = heavy.t
    rates = heavy.dq, np.gradient(heavy.dq, t, axis=0)
    more = replace(
        heavy, tau=heavy.tau + problem.robot.inverse_dynamics(links, heavy.q, *rates)
    )
    estimate = sdp.identify(problem, run, "ols", gain_uncertainty=0.01)
    return {
        "gains": model(
            sdp.identify(problem, run, "ols", known_loads=[(more, 1.5)], check=False)
        ),
        "added": model(sdp.add(estimate, "payload", more)),
        "found": sdp.diagnose(estimate, more, frozen=True).to_dict(),
        "run": [*vars(excitation.payload_run(estimate, iterations=3)).values()][1:],
        "compared": sdp.compare(estimate, more)[0].to_dict(),
    }


def motions() -> dict[str, Any]:
    two = sdp.load_problem("two_link")
    heard = list[str]()
    estimate = sdp.identify(two, two_link_with(lambda r: 0.0), "ols")
    known: dict[str, Any] = {"duration": 6.0, "progress": heard.append}
    found = [
        excitation.excite(two, iterations=3, objective=x, **known)
        for x in excitation.OBJECTIVES
    ]
    told = separation.separate(
        estimate, "torque_ripple:2@k=2,joint_spring:2", iterations=10, **known
    )
    alone = separation.separate(
        estimate, "stribeck_friction:1", duration=6.0, level=0.3, iterations=5
    )
    kept = (
        "delta2",
        "default_delta2",
        "right",
        "default_right",
        "seconds",
        "default_seconds",
        "sizes",
    )
    return {
        "excited": [
            [e.history, e.trajectory.a, e.trajectory.b, e.trajectory.q_0] for e in found
        ],
        "separated": [{k: getattr(x, k) for k in kept} for x in (told, alone)],
        "heard": heard,
    }


def failures() -> dict[str, Any]:
    """Where a model fails: at reversals, with a wave, at rest; a bump that no effect
    is, beside what it holds."""

    def missing(r: sdp.Measurements) -> Any:
        late = np.tanh(np.gradient(r.q, r.t, axis=0) / 0.3) * [0.0, 1.0]
        return (
            late
            + [[0.0, 0.6]] * np.sin(40.0 * r.q)
            + [[0.4, 0.0]] * np.sin(r.q[:, ::-1])
        )

    run = two_link_with(missing)
    estimate = sdp.identify(
        sdp.load_problem("two_link"), two_link_with(lambda r: 0.0), "ols"
    )
    shown = sdp.compare(estimate, run)
    bump = two_link_with(lambda r: [[0.0, 0.5]] * np.exp(-(((r.q - 0.1) / 0.15) ** 2)))
    held = sdp.diagnose(estimate, bump, frozen=True, check=False)
    return {
        "held": held.to_dict(),
        "causes": [f.to_dict() for f in sdp.where_it_fails(estimate, run)],
        "said": sdp.where_it_fails(estimate, run)._summary(),
        "compared": shown[0].to_dict(),
        "frame": shown.to_frame().to_numpy(),
    }


def hidden(*named: tuple[str, list[int]], test: bool, **told: Any) -> dict[str, Any]:
    made = hidden_runs(sdp.load_problem("two_link"), list(named), "strong", seed=24)
    data = concatenate(made.runs[:2])
    tau = data.tau.copy()
    tau[1200:1240, 1] += told.get("knock", 0.0)
    tau[:, 0] += told.get("hum", 0.0) * np.sin(
        2.0 * np.pi * 3.3 * data.t + (data.t > 30.0)
    )
    data = replace(data, tau=tau)
    estimate = sdp.identify(
        made.problem, data, "ols", effects=made.truth["model_effects"], check=False
    )
    heard = list[str]()
    found = sdp.diagnose(
        estimate,
        data,
        made.runs[3] if test else None,
        check=False,
        progress=heard.append,
    )
    out = {
        "found": found.to_dict(),
        "said": [found.headline, found.advice, found.unexplained_sentence],
    }
    rows = diagnosis_rows(data, estimate, estimate.preprocessing.resolve(data))
    every = list_candidates(whiten_rows(rows, estimate)).batches
    out["searched"] = [
        [f.effect.text, f.replaces_own_constant] for b in every for f in b.forms
    ]
    out["white"] = [np.linalg.norm(b.whitened_columns) for b in every]
    if found.effects or found.retuned:
        out["added"] = model(sdp.add(estimate, found, data, progress=heard.append))
    return out | {"heard": heard}


def in_a_curve() -> dict[str, Any]:
    """A torque that no effect is, on a two-axis SCARA with some noise of colour."""
    rng = np.random.default_rng(7)
    noise = SensorNoise(colour=0.6, tails=5.0)
    world = draw_world(
        Conditions("scara", runs=2, duration=12.0, noise=noise, law="dahl"), rng
    )
    runs = []
    for k in range(2):
        motion = draw_motion(world, k, rng)
        extra = np.zeros_like(motion.q)
        extra[:, 0], extra[:, 1] = (
            motion.q[:, 0] ** 3,
            0.4 * motion.q[:, 1] * motion.dq[:, 1],
        )
        runs.append(log_run(world, motion, rng, [extra]).run)
    data = concatenate(runs)
    found = sdp.diagnose(
        sdp.identify(sdp.load_problem(urdf_of("scara")), data, "ols", check=False),
        data,
        check=False,
    )
    return {"found": found.to_dict(), "said": [found.headline, found.advice]}


CASES: Mapping[str, Callable[[Path], Any]] = {
    "effects_arm": lambda _: effects_of("arm"),
    "effects_gantry": lambda _: effects_of("gantry"),
    "identified": identified,
    "servos": of_servos,
    "loads": of_loads,
    "motions": lambda _: motions(),
    "failures": lambda _: failures(),
    "hysteresis": lambda _: hidden(
        ("presliding_hysteresis", [0]), test=False, knock=3.0
    ),
    "pair": lambda _: hidden(
        ("stribeck_friction", [0]), ("joint_spring", [1]), test=True, hum=0.5
    ),
    "curve": lambda _: in_a_curve(),
}
