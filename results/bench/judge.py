"""What the program says of a log, as a user hears it, beside what is true.

`check`, `identify` and `diagnose` see the recordings, never truth.json. A claim is sure
if `check` calls it certain or likely, or `diagnose` confident or a near-tie, or if a
curve is drawn.
"""

import contextlib
import io
import json
import re
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from bench.truth import SAME
from sdp_vs_penalty import check, compare, diagnose, identify
from sdp_vs_penalty.checks import Issue
from sdp_vs_penalty.cli.verbs.add import verb as add_from_file
from sdp_vs_penalty.diagnosis import Diagnosis
from sdp_vs_penalty.effects import effect_in_words
from sdp_vs_penalty.errors import ColumnsRemark, InputError
from sdp_vs_penalty.estimation.estimate import Estimate, load_estimate
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.records import to_json

#: What `check` says of the motion, or of torque without a cause: no claim.
NO_CLAIM = {
    "poor excitation",
    "idle joints",
    "lockstep motion",
    "unexplained torque",
    "torque not explained",
}
#: A joint's error on fresh motion is raised by more than this share.
RAISED = 1.05


@dataclass(frozen=True)
class Claim:
    """What is said of a log, by whom, of which joints (from 1), and whether it is sure."""

    by: str
    text: str
    joints: tuple[int, ...]
    sure: bool
    #: Whether it is read from the file; a fact contradicts no explanation.
    fact: bool = False


@dataclass(frozen=True)
class Row:
    """One log: what came of it."""

    kind: str
    log: str
    #: right, possible or missed.
    outcome: str
    #: Sure claims that are false, in their words.
    false_check: str = ""
    false_diagnose: str = ""
    contradiction: str = ""
    #: The largest ratio of a joint's error on fresh motion, with what `add --helpful`
    #: adds to without; empty where nothing was added.
    largest_ratio: str = ""
    #: The same ratio, geometric mean over joints.
    mean_ratio: str = ""
    said: str = ""
    seconds: float = 0.0


def claims_of_check(issues: Sequence[Issue]) -> Iterator[Claim]:
    """Yield the claims of `check`, each once."""
    seen = set()
    for issue in issues:
        if issue.kind in NO_CLAIM or (issue.kind, issue.where) in seen:
            continue
        seen.add((issue.kind, issue.where))
        rivals = "; ".join(issue.equivalents)
        joints = tuple(issue.figures.get("joints", ()))
        sure = issue.certainty.grade != "possible"
        words = f"{issue.kind} ({issue.where}): {issue.what} {rivals}"
        yield Claim("check", words, joints, sure, issue.nature == "fact")


def claims_of_reading(remarks: Sequence[warnings.WarningMessage]) -> Iterator[Claim]:
    """Yield what was said of units when the files were read: what was settled so."""
    for remark in remarks:
        units = str(remark.message).partition("; ")[2].partition("; the same by")[0]
        if units:
            yield Claim("reading", units, (), True, True)


def claims_of_diagnosis(found: Diagnosis) -> Iterator[Claim]:
    """Yield the claims of `diagnose`."""
    for finding in found.effects:
        words = f"{finding.effect.replace('_', ' ')}: {effect_in_words(finding.text)}"
        rivals = ", ".join(finding.rival_texts).replace("_", " ")
        explained = [x.sentence for x in finding.doubts if x.reason == "explained"]
        rivals = "; ".join(filter(None, (rivals, *explained)))
        text = f"{words}; as well: {rivals}" if rivals else words
        sure = finding.rating != "weak"
        yield Claim("diagnose", text, tuple(finding.joints), sure)
    for retune in found.retuned:
        text = f"re-estimate {retune.text}".replace("_friction", " friction")
        yield Claim("diagnose", text, (retune.joint,), retune.rating == "confident")
    for cause in found.passing:
        yield Claim("diagnose", cause.sentence, (), True)
    for curve in found.curves:
        text = f"curve of {', '.join(curve.of)} on joint {curve.joint}"
        yield Claim("diagnose", text, (curve.joint,), True)


def names(claim: Claim, truth: dict) -> bool:
    """Whether a claim names the cause that is true, on its joints."""
    on_joints = not claim.joints or not truth["joints"]
    on_joints = on_joints or not set(claim.joints).isdisjoint(truth["joints"])
    return bool(truth["right"]) and on_joints and matches(truth["right"], claim.text)


def is_true(claim: Claim, truth: dict) -> bool:
    """Whether a claim names the cause that is true, or something else that is true."""
    besides = matches(truth["besides"], f"{claim.by}: {claim.text}")
    return besides or names(claim, truth)


def matches(pattern: str, text: str) -> bool:
    """Whether a pattern is in a text, in capitals or not."""
    return re.search(pattern, text, re.IGNORECASE) is not None


def contradictions(claims: Sequence[Claim], truth: dict) -> list[str]:
    """Return pairs of sure claims of both programs that explain the same joint's torque
    by different things, where neither names the other among its rivals. What `diagnose`
    states as well is not contradicted by what it finds besides, and two claims that
    are both true do not contradict each other.
    """
    sure = [c for c in claims if c.sure and not c.fact]
    of_check = [c for c in sure if c.by == "check"]
    of_diagnose = [c for c in sure if c.by == "diagnose"]
    out = []
    for a, b in product(of_check, of_diagnose):
        apart = a.joints and b.joints and set(a.joints).isdisjoint(b.joints)
        apart = apart or (is_true(a, truth) and is_true(b, truth))
        if not apart and not any(are_alike(a, c) for c in of_diagnose):
            out.append(f"{short(a)} / {short(b)}")
    return out


def are_alike(one: Claim, other: Claim) -> bool:
    """Whether two claims are about the same torque."""
    return any(matches(x, one.text) and matches(x, other.text) for x in SAME)


def short(claim: Claim) -> str:
    """The claim's first words."""
    return claim.text[:90].split(": ")[0] if claim.by == "check" else claim.text[:90]


#: What is said of a log and its robot: claims, why it is refused ("" if it is not),
#: and ratios of errors on fresh motion.
Engine = Callable[[Path, str], tuple[list[Claim], str, tuple[str, str]]]


def judge(kind: str, folder: Path, engine: Engine) -> Row:
    """Compare what is said of a log with the truth."""
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    begin = time.process_time()
    claims, refused, ratios = engine(folder, truth["robot"])
    seconds = time.process_time() - begin
    right = [c for c in claims if names(c, truth)]
    false = [
        c for c in claims if c.sure and c.by != "reading" and not is_true(c, truth)
    ]
    if any(c.sure for c in right) or (refused and truth["refuses"]):
        outcome = "right"
    elif right:
        outcome = "possible"
    elif truth["silent"] and not false and not refused:
        outcome = "right"
    else:
        outcome = "missed"
    of = {by: [short(c) for c in false if c.by == by] for by in ("check", "diagnose")}
    if refused and not truth["refuses"] and not any(c.sure for c in right):
        of["check"].append(f"refused: {refused[:120]}")
    said = [f"{'' if c.sure else '(possible) '}{short(c)}" for c in claims]
    return Row(
        kind,
        folder.name,
        outcome,
        "; ".join(of["check"]),
        "; ".join(of["diagnose"]),
        "; ".join(contradictions(claims, truth)),
        *ratios,
        said="; ".join([*said, *([f"refused: {refused[:80]}"] if refused else [])]),
        seconds=round(seconds, 1),
    )


def said_of(folder: Path, robot: str) -> tuple[list[Claim], str, tuple[str, str]]:
    """Run the three verbs on a log, and `add` on what helps."""
    problem = str(folder / robot) if (folder / robot).exists() else robot
    runs = sorted(map(str, folder.glob("run*.csv")))
    nothing = ("", "")
    claims: list[Claim] = []
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ColumnsRemark)
        try:
            reports = check(problem, runs, thorough=False)
            claims += claims_of_reading(remarks)
            issues = [i for report in reports for i in report.errors_and_warnings]
            claims += claims_of_check(issues)
            wrong = [i for i in issues if i.severity == "error"]
            if wrong:
                return claims, f"{wrong[0].kind}: {wrong[0].what}", nothing
            model = identify(problem, runs)
            found = diagnose(model, runs)
        except InputError as error:
            return claims, str(error), nothing
        claims += claims_of_diagnosis(found)
        if not found.helpful or not (folder / "fresh.csv").exists():
            return claims, "", nothing
        return claims, "", errors_with(folder, model, found)


def errors_with(folder: Path, model, found: Diagnosis) -> tuple[str, str]:
    """Run the `add --helpful` that is advised, and return the largest and the mean
    ratio of a joint's error on fresh motion; "refused" where it refuses.
    """
    paths = {x: folder / f"{x}.json" for x in ("model", "findings", "added")}
    model.save(paths["model"])
    write_text(paths["findings"], json.dumps(to_json(found.to_dict())))
    runs = sorted(folder.glob("run*.csv"))
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            add_from_file(
                paths["model"],
                runs,
                paths["added"],
                from_=paths["findings"],
                helpful=True,
            )
        return ratios_of(folder, model, load_estimate(paths["added"]))
    except InputError:
        return "refused", ""


def ratios_of(folder: Path, model: Estimate, added: Estimate) -> tuple[str, str]:
    """Return the largest and the mean ratio of a joint's error on fresh motion, of a
    model with what was added to the model without."""
    fresh = str(folder / "fresh.csv")
    ratio = compare(added, fresh)[0].rmse / compare(model, fresh)[0].rmse
    return f"{ratio.max():.3g}", f"{np.exp(np.log(ratio).mean()):.3g}"
