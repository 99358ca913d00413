"""The five stages of the README's picture, each a screen, and what most people do without."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty import show
from sdp_vs_penalty.estimation.verdict import changes
from sdp_vs_penalty.page.part import Stage, Verdict, model_verdict
from sdp_vs_penalty.page.parts.check import CHECK
from sdp_vs_penalty.page.parts.findings import FINDINGS
from sdp_vs_penalty.page.parts.fit import FIT
from sdp_vs_penalty.page.parts.forward import FORWARD
from sdp_vs_penalty.page.parts.methods import METHODS
from sdp_vs_penalty.page.parts.model import MODEL
from sdp_vs_penalty.page.parts.model_history import HISTORY
from sdp_vs_penalty.page.parts.parameters import PARAMETERS
from sdp_vs_penalty.page.parts.proof import PROOF
from sdp_vs_penalty.page.parts.robot import ROBOT
from sdp_vs_penalty.page.parts.runs import RUNS
from sdp_vs_penalty.page.parts.take_away import POSED, TAKE_AWAY
from sdp_vs_penalty.page.session import Session


def _measured(session: Session) -> Verdict | None:
    robot = session.robot
    if robot is None:
        return None
    said = f"{robot['file'] or robot['name']} has {show.count(robot['n'], 'joint')}"
    if session.runs:
        kept = any(run["use"] in ("test", "split") for run in session.runs)
        said += f"; {show.count(len(session.runs), 'run')}, "
        said += f"{'part' if kept else 'nothing'} kept for testing"
    return Verdict("", f"{said}.")


def _checked(session: Session) -> Verdict | None:
    if not session.runs:
        return None
    if session.meaningless:
        return Verdict("bad", f"{session.meaningless[0]}.", "Check failed")
    warned = sorted({f["kind"] for run in session.runs for f in run["findings"]})
    if warned:
        return Verdict("usable", f"It found {show.words(warned)}.", "Check")
    return Verdict("good", f"Nothing wrong in {show.count(len(session.runs), 'run')}.", "Check")


def _identified(session: Session) -> Verdict | None:
    return None if session.model is None else model_verdict(session.model)


def _diagnosed(session: Session) -> Verdict | None:
    """What became of each joint's error, and what the last diagnosis says, where it is of this model."""
    found, added = session.findings, session.added
    said = ""
    if found is not None and added:
        left = sum(f.text not in added for f in found.effects)
        said = f"{show.count(left, 'more finding')} can be added." if left else ""
        said = said or "Diagnose again to see what is missing now."
    elif found is not None:
        said = found.headline
    if len(session.history) > 1:
        first, last = (session.history[k].comparison for k in (0, -1))
        floor = None if None in last["noise_floor"] else np.array(last["noise_floor"], float)
        told = changes(np.array(first["rmse"]), np.array(last["rmse"]), floor)
        told = told or "no joint changed its error by more than 5 %."
        said = f"{told[0].upper()}{told[1:]} {said}".strip()
    return Verdict("", said) if said else None


#: In the order of the work.
STAGES = (
    Stage("measure", "Measure", "", (ROBOT, RUNS), _measured),
    Stage("check", "Check", "Add measurements first.", (CHECK,), _checked),
    Stage("identify", "Identify", "Add measurements first.", (MODEL, FIT, PARAMETERS), _identified),
    Stage("diagnose", "Diagnose", "Identify a model first.", (HISTORY, FINDINGS), _diagnosed),
    Stage("use", "Use", "Identify a model first.", (TAKE_AWAY, FORWARD), _identified),
    Stage("advanced", "Advanced", "Identify a model first.", (METHODS, PROOF, POSED)),
)
