"""What each way to a model of the UR10e errs on motion that it has not seen, by joint.

    python results/real_arms/ur10e.py [--data DATA] [--out FOLDER]

All are fitted to one run and judged on two others, behind the same low-pass and against
the same measured torque. An ordinary script stands for what people do by hand: SciPy's
zero-phase filter, Pinocchio's regressor, and least squares or CVXPY, as on the Panda in
results/benchmarks. It has the terms of `identify`: links, viscous and dry friction, rotors,
offsets. Files of export are judged as
they hold the model. Writes ur10e.csv and ur10e.md.
"""

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
import pandas
from benchmarks.rivals import base_script, cvxpy_script
from numpy.typing import NDArray
from real_arms.real_arms import Split, joint_errors, read_options, ur10e_splits

from sdp_vs_penalty import (
    Estimate,
    Measurements,
    add,
    compare,
    diagnose,
    export,
    identify,
)
from sdp_vs_penalty.api.exporting import judge_as_exported
from sdp_vs_penalty.estimation.nominal import nominal_model
from sdp_vs_penalty.estimators import LmiSdp
from sdp_vs_penalty.exporters.export import as_exported, effects_left_out
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.preprocessing import Preprocessing

Array = NDArray[np.float64]
#: What an ordinary model has beside the links, in the order of the script's columns.
TERMS = "viscous_friction,coulomb_friction,torque_offset,rotor_inertia"
#: The same with the script's width of dry friction, which `identify` estimates otherwise.
GIVEN_WIDTHS = "rigid_body," + TERMS.replace("friction,t", "friction@v_s=0.01,t")
#: What `diagnose` finds on joint 2; the script gets it at every joint.
BY_LOAD = "load_dependent_friction"
#: Of the script's samples at 1 kHz, those whose columns are filtered.
EVERY = 4


def by_hand(file: Estimate, run: Measurements, solve: Callable[..., Array]) -> Estimate:
    """Return the model of an ordinary script: filter, regressor, solve for theta."""
    rows = cvxpy_script.filtered_rows(run.t, run.q, run.tau)
    columns = cvxpy_script.columns(file.robot._model, *rows.states, with_rotors=True)
    return file.with_theta(solve(columns, rows.tau))


def by_cvxpy(columns: Array, tau: Array) -> Array:
    """Least squares under positive semidefinite pseudo-inertias, friction >= 0."""
    return cvxpy_script.solve(columns, tau, inertia.PSEUDO_INERTIA_BASIS)


def by_hand_weighed(
    file: Estimate,
    run: Measurements,
    filters: Preprocessing | None = None,
    links: Array | None = None,
    standstill: float = 0.0,
    loaded_by: Estimate | None = None,
) -> Estimate:
    """Return the script's model with what `identify` has more: joints weighed by their
    errors in a first fit; its filters, behind which columns are as well; links (n, 10) of
    its prior; and rows out in which the joint is slower than standstill [rad/s]: nobody
    knows the dry friction of a joint at rest. loaded_by : a former fit, whose links' torque
    presses the gears; file then has friction by load at every joint, too."""
    script = cvxpy_script
    arm = file.robot._model
    if filters is None:
        rows = script.filtered_rows(run.t, run.q, run.tau)
        columns = script.columns(arm, *rows.states, with_rotors=True)
        tau, dq = rows.tau, rows.states[1]
    else:
        cutoffs = (filters.state_cutoff, filters.torque_cutoff)
        rows = script.filtered_rows(run.t, run.q, run.tau, EVERY, cutoffs)
        columns = script.columns(arm, *rows.states, with_rotors=True)
        if loaded_by is not None:
            rigid = 10 * arm.nv
            load = np.abs(columns[:, :, :rigid] @ loaded_by.theta[:rigid])
            rubs = load * np.tanh(rows.states[1] / script.SIGN_WIDTH)
            columns = np.dstack([columns, rubs[:, :, None] * np.eye(arm.nv)])
        columns = script.low_pass(columns, EVERY * filters.torque_cutoff)
        step = script.DECIMATION // EVERY
        columns, tau, dq = columns[::step], rows.tau[::step], rows.states[1][::step]
    moves = np.abs(dq) >= standstill
    first = base_script.solve(moves[:, :, None] * columns, moves * tau)
    errors = np.ma.masked_array(columns @ first - tau, ~moves)
    weights = moves / errors.std(axis=0).data
    theta = script.solve(
        weights[:, :, None] * columns,
        weights * tau,
        inertia.PSEUDO_INERTIA_BASIS,
        nominal=links,
        weight=LmiSdp().entropy,  # the weighed rows' variance is one
    )
    if loaded_by is not None:  # the model's own load is that of the fit
        file = replace(file, model=replace(file.model, reference=theta))
    return file.with_theta(theta)


def ways(run: Measurements, file: Path) -> Mapping[str, Estimate]:
    """Return every model that is judged, by its name in the table."""
    problem = load_problem(file)
    with_terms = nominal_model(problem).with_effects(
        lambda effect: effect.name in ("rigid_body", *TERMS.split(","))
    )
    links = replace(
        with_terms.with_effects(lambda effect: effect.name == "rigid_body"),
        method="ols",  # of what is fitted beside the links
    )
    names = [parameter.name for parameter in links.model.parameters]
    known = dict(zip(names, links.theta, strict=True))
    bare = identify("ur10e", run, check=False)
    as_identify = (bare.preprocessing, with_terms.links, bare.preprocessing.standstill)
    best = by_hand_weighed(with_terms, run, *as_identify)
    with_load = identify(
        problem, run, check=False, method="ols", effects=f"{GIVEN_WIDTHS},{BY_LOAD}"
    )
    found = diagnose(bare, run, check=False)
    named = [finding for finding in found.helpful if finding.rating != "weak"]
    in_c = [finding for finding in found.helpful if is_held_by_c(bare, finding, run)]
    for_c = add(bare, in_c, run)
    everything = add(bare, found.selected(helpful=True), run)  # as --helpful
    return {
        "maker's file: links, no friction": links,
        "maker's links, fitted friction, rotors, offsets": identify(
            problem, run, check=False, known=known
        ),
        "maker's links, fitted friction, rotors, offsets, gains": identify(
            problem,
            run,
            check=False,
            known=known,
            effects=f"rigid_body,{TERMS},torque_gain",
        ),
        "script, least squares": by_hand(with_terms, run, base_script.solve),
        "script, CVXPY, links can exist": by_hand(with_terms, run, by_cvxpy),
        "script, CVXPY, joints weighed": by_hand_weighed(with_terms, run),
        "script, CVXPY, joints weighed, filters of identify": by_hand_weighed(
            with_terms, run, bare.preprocessing
        ),
        "script, CVXPY, joints weighed, filters and prior of identify": (
            by_hand_weighed(with_terms, run, bare.preprocessing, with_terms.links)
        ),
        "script, CVXPY, the same without rows at standstill": best,
        "script, CVXPY, that, told of friction by load": by_hand_weighed(
            with_load, run, *as_identify, loaded_by=best
        ),
        "identify, widths of dry friction not estimated": identify(
            "ur10e", run, check=False, effects=GIVEN_WIDTHS
        ),
        "identify without its prior": identify(
            "ur10e", run, check=False, method=LmiSdp(entropy=0.0)
        ),
        "identify": bare,
        "identify, as URDF": as_exported(bare, "arm.urdf"),
        "identify, as URDF, identified again": refitted(bare, "arm.urdf", run),
        "with effects whose name is sure": add(bare, named, run),
        "with all that helps": everything,
        "with all that helps, as C": as_exported(everything, "model.h"),
        "with all that helps, as C, identified again": refitted(
            everything, "model.h", run
        ),
        "with what C holds, as C": as_exported(for_c, "model.h"),
    }


def refitted(model: Estimate, out: str, run: Measurements) -> Estimate:
    """Return the model that `export --refit` writes."""
    filtered = FilteredRuns.filtering(run, model.preprocessing.resolve(run))
    (whole,) = compare(model, filtered)
    held = judge_as_exported(model, out, filtered, whole, training=filtered)
    assert held is not None  # the file lacks effects
    return held.model


def is_held_by_c(bare: Estimate, finding: object, run: Measurements) -> bool:
    """Return whether a C header has a place for an effect that was found."""
    return not effects_left_out(add(bare, [finding], run), "model.h")


#: Calls it N times at states that differ, and prints microseconds a call.
LOOP = """#include "model.h"
#include <stdio.h>
#include <time.h>
#define N 1000000
int main(void) {
  double q[JOINTS], dq[JOINTS], ddq[JOINTS], tau[JOINTS], sum = 0.0;
  clock_t begin = clock();
  for (int k = 0; k < N; k++) {
    for (int i = 0; i < JOINTS; i++) q[i] = dq[i] = ddq[i] = 1e-6 * k + i;
    TORQUE(q, dq, ddq, tau);
    sum += tau[0];
  }
  printf("%g %g", 1e6 * (clock() - begin) / CLOCKS_PER_SEC / N, sum);
  return 0;
}
"""


def microseconds_a_call(model: Estimate) -> float:
    """Return the processor time of a call of the C header [us], by `cc -O2`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export(model, folder / "model.h")
        (torque,) = re.findall(
            r"inline void (\w+_torque)\(", (folder / "model.h").read_text()
        )
        (folder / "loop.c").write_text(LOOP)
        defined = [f"-DTORQUE={torque}", f"-DJOINTS={model.robot.n}"]
        words = ["cc", "-O2", *defined, "loop.c", "-o", "loop", "-lm"]
        subprocess.run(words, cwd=folder, check=True)
        done = subprocess.run([folder / "loop"], capture_output=True, check=True)
        return float(done.stdout.split()[0])


def torque_rms(runs: Measurements, filtered_as: Estimate) -> Array:
    """Return each joint's RMS torque (n,) [N m], behind the filters of a model."""
    (judged,) = compare(filtered_as, runs)
    return np.sqrt(np.mean(np.square(judged.signals.measured), axis=0))


def by_joint(values: Array) -> dict[str, object]:
    """Return a cell a joint."""
    return {f"joint_{k}": x for k, x in enumerate(values.tolist(), start=1)}


def name_of(split: Split) -> str:
    """Return the file that a split judges on."""
    return split.name.split()[-1]


def table(rows: pandas.DataFrame) -> list[str]:
    """Return a table a judged run: a row a way, a column a joint [N m]."""
    text: list[str] = []
    for run, of_run in rows.groupby("judged_on", sort=False):
        joints = [c for c in rows.columns if c.startswith("joint_")]
        cells = [
            [str(row["model"]), *(f"{row[joint]:.3g}" for joint in joints)]
            for _, row in of_run.iterrows()
        ]
        header = ["model", *(joint.removeprefix("joint_") for joint in joints)]
        text += ["", f"## Judged on {run} [N m]", "", *markdown_lines(header, cells)]
    return text


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit every model once, judge it on both runs, and write both files."""
    parser = argparse.ArgumentParser(description=__doc__)
    options = read_options(parser, arguments)
    splits = list(ur10e_splits())
    models = ways(splits[0].train, options.data / splits[0].file)
    made: list[dict[str, object]] = []
    for split in splits:
        made.append({"judged_on": name_of(split), "model": "the torque itself"})
        made[-1] |= by_joint(torque_rms(split.unseen, models["identify"]))
        for name, model in models.items():
            errors = joint_errors(model, split.unseen, models["identify"])
            row = {"judged_on": name_of(split), "model": name, **by_joint(errors)}
            made.append(row)
    rows = pandas.DataFrame(made)
    in_c = models["with what C holds, as C"]
    rows.to_csv(options.out / "ur10e.csv", index=False, float_format="%.6g")
    text = [
        "# The UR10e by several ways: RMS error of the torque on unseen motion",
        "",
        "Fitted to the run of 12 February 2020, judged on two of 19 February. By"
        " `python results/real_arms/ur10e.py`.",
        *table(rows),
        "",
        f"A call of the C header takes {microseconds_a_call(in_c):.2g} microseconds of"
        " processor time (`cc -O2`).",
    ]
    write_text(options.out / "ur10e.md", "\n".join(text) + "\n")


if __name__ == "__main__":
    main()
