"""A tab's models: identified, diagnosed, extended, and asked."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.certainty import POSSIBLE
from sdp_vs_penalty.data.measurements import UNNAMED_UNIT
from sdp_vs_penalty.diagnosis.causes import TIME, VELOCITY
from sdp_vs_penalty.diagnosis.finding import is_law_of
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import CAUSES
from sdp_vs_penalty.effects import (
    DEFAULT_EFFECTS,
    effect_in_words,
    effect_name,
    effect_types,
    effects_in_words,
)
from sdp_vs_penalty.effects.written import read_effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page.commands import commands_of
from sdp_vs_penalty.page.model_step import ModelStep, is_among, joints_of
from sdp_vs_penalty.page.project import UNDO
from sdp_vs_penalty.page.runs import RobotAndRuns
from sdp_vs_penalty.page.spoken import graded
from sdp_vs_penalty.page.worker import sentence
from sdp_vs_penalty.render.words import shown_cause, shown_finding
from sdp_vs_penalty.results.issue import StoredIssue
from sdp_vs_penalty.results.remedy import Change

#: File of a motion to record.
MOTION = "trajectory.csv"


def _acts_as(text: str, effect: str, joints: Collection[int]) -> bool:
    """Whether an effect, as `add` writes it, is a law of another one on these joints."""
    written = read_effect(text)
    return is_law_of(written.name, effect) and {*joints} <= {*written.joints}


def since(begin: float, read: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays of a run with its instants t and tf from ``begin`` on [s], which
    stands beside them."""
    times = {name: read[name] - begin for name in read if name in ("t", "tf")}
    return {**read, **times, "begin": np.array(begin)}


@dataclass
class Models(RobotAndRuns):
    """A project whose models can be identified, diagnosed and extended."""

    #: By job the last answer, with the ``model`` that it is about.
    answers: dict[str, dict[str, Any]] = field(default_factory=dict)

    def commands(self) -> list[str]:
        """Return the command lines that repeat this session's work, one for each step.

        They name files as the page shows them, to be run in the folder of the logs.
        """
        return [formatting.command(*words) for words in self.command_words()]

    def command_words(self) -> list[list[str]]:
        """Return the words of each of these commands."""
        return commands_of(self)

    @property
    def first_and_current(self) -> list[ModelStep]:
        """The first and the current model of the history; a single one if they are
        the same.
        """
        first = self.history[0]
        current = self.current
        return [current] if current is first else [first, current]

    @property
    def findings_of_current(self) -> Diagnosis | None:
        """The diagnosis of the current model; None if it was not diagnosed."""
        return self.model.findings if self.model else None

    @property
    def diagnosed(self) -> ModelStep:
        """The model of the history that was diagnosed last."""
        return next(model for model in self.history[::-1] if model.findings)

    @property
    def findings(self) -> Diagnosis | None:
        """The last diagnosis, perhaps of an earlier model; None without one."""
        found = (model.findings for model in self.history[::-1] if model.findings)
        return next(found, None)

    @property
    def added(self) -> set[str]:
        """The effects added to the model since the last diagnosis, as `add` writes
        them.
        """
        texts = set[str]()
        for model in self.history:
            texts = set() if model.findings else texts.union(model.added)
        return texts

    @property
    def hidden_and_found(self) -> str:
        """A sentence on the effect that was hidden in simulated runs, and what the last
        diagnosis says of it; "" for measured runs, and without a diagnosis."""
        diagnosis = self.findings
        if diagnosis is None or not self.hidden:
            return ""
        # "joint_coupling:2+3" is an effect on joints 2 and 3, "base_tilt" on the arm.
        effect = read_effect(self.hidden).name
        if effect == "none":
            return "Nothing was hidden in these runs."
        joints = joints_of(self.hidden)
        added = [text for step in self.history for text in step.added]
        found = [finding.text for finding in diagnosis.effects]
        absorbed = [x for x in diagnosis.invisible if x.effect == effect]
        by_law = [text for text in (*added, *found) if _acts_as(text, effect, joints)]
        if by_law:
            name = read_effect(by_law[0]).name
            named = "" if name == effect else f", as {effect_name(name)}"
            in_model = ", and in the model" if by_law[0] in added else ""
            outcome = f"found{named}{in_model}"
        elif any(joints.issubset(x.joints) for x in absorbed):
            outcome = "not found: parameters of the model absorb it in these runs"
        else:
            outcome = "not found by this name"
        return f"We hid {effect_in_words(self.hidden)}: {outcome}."

    def cause_of(self, joint: int) -> str:
        """Return the cause that shows the error of a joint (from 1): that of its
        finding, or else the one that the error depends on most; TIME without any."""
        if not self.current.failures:
            return VELOCITY
        finding = shown_finding(self.findings_of_current, joint)
        cause = shown_cause(finding, self.current.where_it_fails, joint)
        return cause if cause in CAUSES else TIME

    @property
    def fault_of_differing_test(self) -> str:
        """What the check says is wrong with the log of a run in which the model errs far
        more, in a sentence: an error, or a likely cause that the person was not led to;
        "" where the arm itself may have changed."""
        differing = {name.partition(", ")[0] for name in self.current.differing_tests}
        for run in self.runs:
            for issue in run["findings"] if run["name"] in differing else ():
                is_new = issue.kind not in self.seen_issues
                is_new &= issue.severity == "warning" and not issue.is_another_arm
                grade = issue.certainty.grade
                if issue.severity == "error" or (is_new and grade != POSSIBLE):
                    said = graded(
                        issue.what.partition(" only: ")[2] or issue.what, grade
                    )
                    return f"{run['name']}: {said}"
        return ""

    def is_of_held_model(self, text: str) -> bool:
        """Whether an effect, as `add` writes it, was found beside a fixed model that has it
        already: then it is another size of that, which is identified again."""
        found = self.findings
        is_fixed = found is not None and found.frozen
        several = effect_types()[read_effect(text).name].several
        is_own = bool(joints_of(text)) and is_among(text, self.current.effects)
        return is_fixed and is_own and not several

    def answer(self, job: str) -> dict[str, Any] | None:
        """Return the last answer of a job, such as "methods", for the current model.

        None if the job was not run for this model.
        """
        stored = self.answers.get(job)
        if stored is None or self.model is None:
            return None
        return stored if stored["model"] == self.model.file else None

    async def ask(self, title: str, job: str, **on: Any) -> None:
        """Run a job that changes nothing, and keep its answer for the current model."""
        model = self.current.file
        self.answers[job] = {**await self._job(title, job, **on), "model": model}

    def recording(self, model: ModelStep, run: str) -> dict[str, Any]:
        """Load the curves of one run as a model explains it.

        Parameters
        ----------
        model : ModelStep
            A model of the history.
        run : str
            Name of one of the model's runs.

        Returns
        -------
        dict
            t (M,) [s] from the run's first sample, and where that is on the clock of the
            log, "begin" [s]; torque, modelled, q, dq, ddq (M, n); tf (F,) [s] and poses
            (F, joints, 4, 4): instants and poses of the arm for the 3D view.
        """
        read = self.arrays(f"{Path(model.file).stem}-{model.runs.index(run)}.npz")
        return since(self.begin_of(run), read)

    def preview(self, run: str) -> dict[str, Any]:
        """Load the signals of a run by its name, as the check sees them, on the clock of
        :meth:`recording`."""
        (one,) = (x for x in self.runs if x["name"] == run)
        return since(self.begin_of(run), self.arrays(one["view"]))

    def begin_of(self, run: str) -> float:
        """Return where a run begins on the clock of its log [s]; run : its name, perhaps
        with the seconds of a part, "run1, 3 to 9 s". 0 of a run that is gone."""
        name = run.partition(", ")[0]
        views = [x["view"] for x in self.runs if x["name"] in (run, name)]
        t = self.arrays(views[0])["t"] if views else np.zeros(1)
        return float(t[0]) if len(t) else 0.0

    def arrays(self, name: str) -> dict[str, Any]:
        """Load the arrays, by name, that a job saved as an .npz file in the
        session's folder.
        """
        with np.load(self.folder / name, allow_pickle=False) as read:
            return dict(read)

    def place_in_pictures(self, issue: StoredIssue, run: str) -> str:
        """Say where an issue is on the clock of a run's pictures; "" of one about no
        instant, and where that clock is the log's."""
        begin = self.begin_of(run)
        if issue.at is None or not begin:
            return ""
        texts = [f"{t - begin:.4g}" for t in issue.span or [issue.at]]
        return f"In the pictures: {' to '.join(texts)} s."

    async def identify_from(self, names: Collection[str]) -> None:
        """Identify the model again from the runs of these names, and test on the others."""
        uses = ["train" if run["name"] in names else "test" for run in self.runs]
        runs = [{**run, "use": use} for run, use in zip(self.runs, uses, strict=True)]
        which = formatting.words([*names]) if "test" in uses else "all runs"
        title, label = f"Identifying from {which}", f"identified from {which}"
        effects = self.current.effects if self.model else self.effects
        self._begin(await self._fit(title, effects, label=label, runs=runs))
        self.runs = runs

    async def set_aside(self) -> None:
        """Identify without the runs that differ, and test on them too."""
        training = [run for run in self.runs if run["use"] == "train"]
        apart = self.differing_runs
        await self.identify_from([x["name"] for x in training if x not in apart])

    async def identify(self) -> None:
        """Identify the first model of a new history with the chosen effects and
        method.
        """
        title = "Identifying the model"
        self._begin(await self._fit(title, self.effects, label="identified"))

    async def identify_without_units(self) -> None:
        """Identify from torques as they are logged, in a unit that nobody has named: the
        model's ratios are right, and its kilograms are none."""
        unit = {"torque_unit": UNNAMED_UNIT}
        runs = [run if run.get("torque_unit") else {**run, **unit} for run in self.runs]
        title, label = "Identifying without units", "identified without units"
        self._begin(await self._fit(title, self.effects, label=label, runs=runs))
        self.runs = runs

    async def _fit(
        self, title: str, effects: Sequence[str], label: str = "", **details: Any
    ) -> ModelStep:
        """Return the model with these effects that is identified from the runs, as a step of
        the history. What was found with a model fixed is in its last link."""
        if not effects:
            raise InputError(
                "No effect is chosen", f"choose at least {DEFAULT_EFFECTS[0]}"
            )
        self._refuse_meaningless()
        known = effect_types()
        free = [x for x in effects if not known[read_effect(x).name].frozen_only]
        request = {
            "effects": ",".join(free),
            "method": self.method,
            "anyway": self.anyway,
            **details,
        }
        return await self._step(title, "fit", request, label=label)

    async def identify_anyway(self) -> None:
        """Identify from runs that the check calls meaningless."""
        self.anyway = True
        try:
            await self.identify()
        except InputError as error:
            self.impossible = sentence(error)
            raise

    async def open_model(self, path: str, name: str) -> None:
        """Begin a new history with a model.json, perhaps identified from other runs.

        This is how a payload is identified: the model of the arm stays fixed.
        """
        self.names[path] = name
        step_fields = {"label": name, "opened": name}
        self._begin(
            await self._step(
                f"Opening {name}", "open_model", {"model": path}, **step_fields
            )
        )

    async def _step(
        self, title: str, job: str, request: dict[str, Any], **step_fields: Any
    ) -> ModelStep:
        """Run a job that makes a model, and return that model as a step of the history.

        step_fields : fields of ModelStep that the job's answer does not hold.
        """
        out = self.folder / f"model-{len([*self.folder.glob('model-*.json')]) + 1}.json"
        return ModelStep(
            **await self._job(title, job, out=str(out), **request), **step_fields
        )

    def _begin(self, step: ModelStep) -> None:
        """Begin a new history with this model, and point the page to its fit."""
        self._step_from_here(step.label)
        self.history = [step]
        self.new = ("identify", "fit")

    @property
    def runs_since(self) -> list[dict[str, Any]]:
        """The runs that may show what has changed since the model was identified, such as
        a load: those that it was not identified from."""
        if self.history[0].opened:
            return self.runs
        changed = self.current.changed_runs
        tested = [run for run in self.runs if run["use"] == "test"]
        return [run for run in tested if run["name"] in changed] or tested

    async def keep_model(self) -> None:
        """Keep the model, and go on with the runs alone that may show what has changed
        since: as if it were opened with them on a page of its own."""
        if not self.runs_since:
            what = "A load is part of a model that is identified with it"
            raise InputError(what, "bring a run with the load, or a model without it")
        runs = [{**run, "use": "train"} for run in self.runs_since]
        if len(runs) == 1 and runs[0]["split"]:
            runs[0]["use"] = "split"
        commands = self.command_words()
        request = {"model": self.current.file, "runs": runs}
        n_made = sum(words[0] in ("identify", "add") for words in commands)
        kept = {"label": "what has changed since", "opened": f"model{n_made}.json"}
        left = await self._job("Checking the runs", "check_again", runs=runs)
        step = await self._step("Testing the model", "open_model", request, **kept)
        names = formatting.words([run["name"] for run in runs])
        self._begin(step)
        self._take(left)
        self.prepared = commands
        self.effects = step.effects
        self.say(
            f"Only {names} is here now, beside the model as it was. {UNDO} the other"
            " runs back.",
            error=False,
        )

    async def find_change(self) -> None:
        """Look with the model as it is for a load, or for what else has changed since."""
        if not self.history[0].opened:
            await self.keep_model()
        await self.diagnose(frozen=True)

    async def diagnose(self, frozen: bool = False) -> None:
        """Diagnose which effects the current model misses, and store that with the
        model; ``frozen``: its parameters are kept."""
        self._refuse_meaningless()
        pictures = f"cards-{Path(self.current.file).stem}.npz"
        how = {
            "frozen": frozen,
            "pictures": pictures,
            "verdict": self.current.comparison["verdict"],
            # Records of older versions do not say what a file loses.
            "exported": {
                file: {"loss": "", **record}
                for file, record in self.current.exported.items()
            },
        }
        answer = await self._job("Looking for what is missing", "find", **how)
        diagnosis = Diagnosis.from_dict(answer["diagnosis"])
        # A model that lacks a confident finding gets a lower grade.
        verdict = answer["verdict"]
        exported = {
            file: {**self.current.exported[file], "verdict": one}
            for file, one in answer["verdicts"].items()
        }
        diagnosed = replace(
            self.current,
            findings=diagnosis,
            curve_texts=tuple(answer["curves"]),
            pictures=pictures,
            exported=exported,
            comparison={**self.current.comparison, "verdict": verdict},
        )
        self.history = [*self.history[:-1], diagnosed]
        self.new = "diagnose", "history"

    async def add(self, text: str) -> None:
        """Add an effect by its text to the current model, which is kept for one that only
        a fixed model shows."""
        words = f"add {effect_in_words(text)}"
        change = Change("add", words, {"effects": [text]}).to_dict()
        frozen = effect_types()[read_effect(text).name].frozen_only
        if frozen and not self.history[0].opened:
            await self.keep_model()
        await self._add(change, frozen)

    async def _add(self, change: Mapping[str, Any], frozen: bool = False) -> None:
        """Add what a change says to the current model; the result is a new step of the
        history."""
        texts = change["arguments"]["effects"]
        diagnosis = self.findings
        frozen = frozen or (diagnosis is not None and diagnosis.frozen)
        request: dict[str, Any] = {
            "change": change,
            "frozen": frozen,
            "diagnosed": diagnosis and diagnosis.to_dict(),
        }
        chosen_on = self.current.chosen_on
        if diagnosis is not None and diagnosis.held_out_source == "test":
            chosen_on = tuple(dict.fromkeys((*chosen_on, *self.current.judged_on)))
        label = f"with {formatting.count(len(texts), 'finding')}"
        if len(texts) <= 1:
            label = f"with {effects_in_words(texts) or 'measured curves'}"
        step = await self._step(
            "Adding what was chosen",
            "extend",
            request,
            label=label,
            added=tuple(texts),
            findings_added=change["arguments"].get("findings"),
            chosen_on=chosen_on,
            frozen=frozen,
        )
        self._step_from_here(change["words"], keeps_models=True)
        self.history = [*self.history, step]
        self.new = "diagnose", "history"

    async def make_motion(
        self, change: Mapping[str, Any], ready: Callable[[str], None]
    ) -> None:
        """Make the motion that a remedy asks to record; ``ready`` is called with its
        file's name."""
        separate = change.get("arguments", {}).get("separate", ())
        how: dict[str, Any] = {"separate": separate}
        # Effects are told apart beside the last model that holds none of them.
        for model in self.history if separate else ():
            if not any(is_among(text, model.effects) for text in separate):
                how["model"] = model.file
        answer = await self._job("Making a motion", "motion", **how)
        self.taken = {*self.taken, answer["file"]}
        self.say(answer["words"], error=False)
        ready(answer["file"])
