"""The race of the check with the library's effects as columns, in place of `diagnose`.

Rows, noise and candidates are those of `diagnose`: white rows, each effect of the
library on each joint at its starting constants. Score, screening, held-out witness and
equivalence set are those of the race (`sdp_vs_penalty/race/`). Nothing is refined,
exchanged or dropped, no law is tolerated to be only nearly right, no torque is referred
to what was found, and no span and no curve is drawn.
"""

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from bench.greedy import load_runs
from bench.judge import Claim, claims_of_check, ratios_of
from sdp_vs_penalty import add, check, identify, load_problem
from sdp_vs_penalty.diagnosis.candidates import list_candidates
from sdp_vs_penalty.diagnosis.library import Candidate
from sdp_vs_penalty.diagnosis.white_rows import WhiteData, diagnosis_rows, whiten_rows
from sdp_vs_penalty.effects import effect_in_words
from sdp_vs_penalty.effects.effect import JointEffect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.arm_fit import orthonormal
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import prior_of_one_of
from sdp_vs_penalty.race.race import Race
from sdp_vs_penalty.race.records import ExtraTorque, Hypothesis
from sdp_vs_penalty.race.rows import base_columns

Array = NDArray[np.float64]


class WhiteLog:
    """White rows as the race's evidence asks of a log; no transform changes them."""

    def __init__(self, white: WhiteData, rows: slice = slice(None)) -> None:
        """Take every row, or a slice of them."""
        self.white, self.at = white, rows
        model = white.estimate.model
        parts = list(zip(model.effects, model.indices, strict=True))
        links = [(e, k) for e, k in parts if not isinstance(e, JointEffect)]
        shared = Model(model.robot, tuple(e for e, _ in links)) if links else None
        dependence, independent = base_columns(shared)
        of_links = [int(i) for _, k in links for i in k]
        X = white.X[:, rows]
        self.n = white.n
        self.shared_columns = X[:, :, [of_links[i] for i in independent]]
        own = [int(i) for e, k in parts if isinstance(e, JointEffect) for i in k]
        self.y = white.y[:, rows]
        count = self.y.shape[1]
        width = max([1, *(int(X[j][:, own].any(axis=0).sum()) for j in range(self.n))])
        columns = np.zeros((self.n, count, width))
        for j in range(self.n):
            of_joint = X[j][:, own]
            of_joint = of_joint[:, of_joint.any(axis=0)]
            columns[j, :, : of_joint.shape[1]] = of_joint
        self.basis_of_own = orthonormal(columns)
        self.moving = self.y.any(axis=1)
        self.problem = white.estimate.problem
        self.as_logged = LogTransform.unchanged(self.n, self.problem.robot.gravity)
        still = np.zeros((count, self.n))
        self.data = SimpleNamespace(
            count=count,
            shared=shared,
            dependence=dependence,
            independent=independent,
            own_columns=columns,
            velocity_sign=0.0,
            run=white.rows.run[rows],
            motion=Motion(white.rows.t[rows], still, still, still),
        )
        self.n_kept = 0

    def select_rows(self, rows: slice) -> "WhiteLog":
        """Return some of the rows."""
        return WhiteLog(self.white, rows)

    def basis(self, transform: LogTransform) -> Array:
        """Return the basis of each joint's own columns."""
        return self.basis_of_own

    def raw(self, transform: LogTransform) -> Array:
        """Return the model's columns."""
        return self.shared_columns

    def torque_mask(self, transform: LogTransform) -> Array:
        """Return that all rows count."""
        return np.ones(self.y.shape)

    def channels(self, transform: LogTransform) -> Array:
        """Return the white torque."""
        return self.y

    def motion(self, transform: LogTransform) -> Motion:
        """Return no velocities: that friction takes power is no evidence of effects."""
        return cast(Motion, self.data.motion)

    def prepare_columns(self, transforms: Any) -> None:
        """Columns are there already."""


class LibraryRace(Race):
    """The race of the library's effects on white rows."""

    def __init__(self, white: WhiteData) -> None:
        """Take the rows, and all candidates of `diagnose`."""
        self.kinds = (cast(ModuleType, self),)
        self.is_doubtful = False
        self.first_looks = {}
        self.all_rows = Evidence(cast(Any, WhiteLog(white)))
        self.few_rows = self.all_rows.of_rows(slice(None, None, c.THIN))
        self.forms = dict[Hypothesis, Candidate]()
        batches = list_candidates(white).batches
        transform = self.all_rows.log.as_logged
        prior = prior_of_one_of(sum(len(b.forms) for b in batches))
        for batch in batches:
            for f, form in enumerate(batch.forms):
                h = self._hypothesis(white, form, batch.columns(f), transform, prior)
                self.forms[h] = form

    def _hypothesis(
        self,
        white: WhiteData,
        form: Candidate,
        columns: dict[int, Array],
        transform: LogTransform,
        prior: float,
    ) -> Hypothesis:
        """Return a candidate as a hypothesis, with the prior of its sizes."""
        on_rows = np.zeros((*white.y.shape, form.n_coefficients))
        for j, z in columns.items():
            on_rows[j] = z
        energy = float(np.sum(white.y[list(columns)] ** 2))
        squares = np.maximum(np.sum(on_rows**2, axis=(0, 1)), 1e-200)
        sd = np.where(
            np.isnan(form.plausible), np.sqrt(energy / squares), form.plausible
        )
        extra = ExtraTorque(on_rows, sd, bool(form.nonnegative[0]))
        name = form.effect.name
        kind = f"re-estimate {name}" if form.replaces_own_constant else name
        joint = () if form.key[1] is None else (form.key[1],)
        return Hypothesis(
            kind, joint, prior, transform, extra_torque=extra, effect=form.text
        )

    def propose(self, evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
        """Yield all candidates whose effect is not taken on their joint yet."""
        taken = {id(x.columns) for x in fit.view.extra_torques}
        keys = {
            h.key
            for h in self.forms
            if h.extra_torque is not None and id(h.extra_torque.columns) in taken
        }
        yield from (h for h in self.forms if h.key not in keys)


def claims_of(race: LibraryRace) -> tuple[list[Claim], list[str]]:
    """Return what the race claims, and the sure effects as `add` takes them."""
    verdict = race.run()
    claims, texts = [], []
    for claim in verdict.claims:
        h = claim.hypothesis
        form = race.forms[h]
        others = sorted({x.hypothesis.kind for x in claim.rivals})
        words = f"{h.kind}: {effect_in_words(form.text)}; as well: {', '.join(others)}"
        words = words.replace("_", " ").replace("v s", "v_s")
        sure = verdict.is_sure_of(claim)
        joints = tuple(j + 1 for j in h.joints)
        claims.append(Claim("diagnose", words, joints, sure))
        if sure:
            texts.append(form.text)
    return claims, texts


def said_of(folder: Path, robot: str) -> tuple[list[Claim], str, tuple[str, str]]:
    """Return the claims of `check` and of the race on a log."""
    nothing = ("", "")
    claims: list[Claim] = []
    name = str(folder / robot) if (folder / robot).exists() else robot
    paths = sorted(map(str, folder.glob("run*.csv")))
    try:
        reports = check(name, paths, thorough=False)
        issues = [i for report in reports for i in report.errors_and_warnings]
        claims += claims_of_check(issues)
        wrong = [i for i in issues if i.severity == "error"]
        if wrong:
            return claims, f"{wrong[0].kind}: {wrong[0].what}", nothing
        problem = load_problem(name)
        runs = load_runs(problem, folder)
        model = identify(problem, runs)
        rows = diagnosis_rows(runs, model, model.preprocessing.resolve(runs))
        found, texts = claims_of(LibraryRace(whiten_rows(rows, model)))
        claims += found
        if not texts or not (folder / "fresh.csv").exists():
            return claims, "", nothing
        return claims, "", ratios_of(folder, model, add(model, ",".join(texts), runs))
    except (InputError, ValueError, np.linalg.LinAlgError) as error:
        return claims, str(error), nothing
