"""Jobs about a model or a robot's file that change nothing: run forward, proved, posed, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.checks import urdf
from sdp_vs_penalty.data.cli_parsing import time_windows
from sdp_vs_penalty.data.files import windowed
from sdp_vs_penalty.estimation.estimate import load_estimate
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.estimation.pose import PoseOptions
from sdp_vs_penalty.estimation.verify import verify_proof_file
from sdp_vs_penalty.exporters import sdp
from sdp_vs_penalty.page.run_jobs import Answer, Progress, Request, runs_of
from sdp_vs_penalty.page.summary import placed, save_arrays
from sdp_vs_penalty.simulation.follow import follow


def forward(request: Request, progress: Progress) -> Answer:
    """A model run along the judged runs: what `sdp-vs-penalty simulate --follow` does.

    Its arrays, as .npz : t0, measured0, simulated0 of the first free run, t1, ...; and of some instants
    tf0 (F,), poses0 (F, 2 joints, 4, 4), the measured arm before the simulated one.
    """
    estimate = load_estimate(request["model"])
    made = follow(
        estimate,
        runs_of(request).judge,
        drive=request["drive"],
        seed=int(request["seed"]),
        progress=progress,
    )
    arrays: dict[str, Any] = {}
    for k, free in enumerate(made.free):
        both = free.measured, free.simulated.q
        arrays |= {f"t{k}": free.simulated.t, f"measured{k}": both[0], f"simulated{k}": both[1]}
        arms = [placed(estimate.robot, free.simulated.t, q) for q in both]
        arrays |= {f"tf{k}": arms[0][0], f"poses{k}": np.concatenate([a[1] for a in arms], axis=1)}
    file = Path(request["folder"]) / f"forward-{made.drive}.npz"
    save_arrays(file, arrays)
    heads, rows = made.table()
    return {
        "file": str(file),
        "runs": [f"{f.simulated.names[0]}, from {f.simulated.t[0]:.4g} s" for f in made.free],
        "verdict": made.verdict,
        "explained": made.explained,
        "units": list(made.units),
        "heads": heads,
        "rows": rows,
        "left_out": list(made.left_out),
    }


def prove(request: Request, progress: Progress) -> Answer:
    """The model identified again with a proof, as `identify --proof` does, and that verified."""
    model, out = load_estimate(request["model"]), Path(request["folder"]) / "proof.json"
    runs = windowed(runs_of(request).train, time_windows(request["window"]))
    identify(
        model.problem,
        runs,
        model.method,
        effects=model.model.effects,
        weighting=model.weighting,
        seed=int(request["seed"]),
        progress=progress,
        proof=out,
    )
    progress("checking the proof")
    return {**verify({"proof": str(out)}, progress), "files": [out.name]}


def verify(request: Request, progress: Progress) -> Answer:
    """What `sdp-vs-penalty verify` says of a proof."""
    holds, said = verify_proof_file(request["proof"])
    return {"holds": holds, "said": said}


def pose(request: Request, progress: Progress) -> Answer:
    """The SDP behind a model as a file, and what it means: what `sdp-vs-penalty export-sdp` does."""
    model, out = load_estimate(request["model"]), Path(request["folder"]) / request["name"]
    runs = windowed(runs_of(request).train, time_windows(request["window"]))
    options = PoseOptions(model.model.effects, weighting=model.weighting, seed=int(request["seed"]))
    sdp.write_posed(model.problem, runs, out, model.method, options, progress)
    return {"files": [out.name, f"{out.name}.json"]}


def check_urdf(request: Request, progress: Progress) -> Answer:
    """What `sdp-vs-penalty check-urdf` says, and its mended copy."""
    path, out = request["robot"]["source"], Path(request["folder"]) / "fixed.urdf"
    checks = urdf.check_urdf(path)
    broken = [c for c in checks if not c.consistent]
    if broken:
        urdf.write_nearest(path, checks, out)
    return {
        "urdf": path,
        "possible": not broken,
        "said": urdf.sentences(checks, urdf.massless_links(path)),
        "rows": urdf.table(checks),
        "files": [out.name] if broken else [],
    }
