"""A tab's robot and runs: how they come, and what each is used for."""

import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.catalogue import DATASETS
from sdp_vs_penalty.data.files import for_testing
from sdp_vs_penalty.data.formats import FILE_SEPARATOR, suffixes
from sdp_vs_penalty.data.measurements import UNNAMED_UNIT
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.page.commands import option_words
from sdp_vs_penalty.page.model_step import ModelStep
from sdp_vs_penalty.page.project import UNDO
from sdp_vs_penalty.page.run_issues import RunIssues, asks_for_unit, is_refused
from sdp_vs_penalty.robot.model_files import ROBOT_FILE_ENDINGS
from sdp_vs_penalty.simulation.hidden_runs import RUN_FILES

#: Endings of files by what they are for, in the order in which they are opened.
ENDINGS = {
    "robot": ROBOT_FILE_ENDINGS,
    "runs": (*suffixes(), ".txt", ".tsv", ".dat", ".log"),  # tables as text
    "model": (".json",),
}
#: What is said where the robot or runs for fitting have changed.
_DROPPED = f"{{}} dropped, since identified from what was there before: {UNDO} it back."


def kind_of(name: str) -> str:
    """Return what a file is for by its ending, a key of ENDINGS; "" for none."""
    ending = Path(name).suffix.lower()
    return next((kind for kind, known in ENDINGS.items() if ending in known), "")


def _options_of(columns: Sequence[str], chosen: Mapping[str, str]) -> dict[str, str]:
    """Return the options of `convert` that read files with these columns as they were
    chosen, by our names.

    Raises InputError where nothing is chosen, or a column twice.
    """
    pairs = {k: v for k, v in chosen.items() if v and k != "rate"}
    if not pairs:
        needed = [name for name in chosen if name != "rate"]
        where = f"choose one for each of {needed[0]} to {needed[-1]}"
        raise InputError("No column is chosen", where)
    taken = [*pairs.values()]
    for column in taken:
        if taken.count(column) > 1:
            what = f"column {column} is chosen more than once"
            raise InputError(what, "choose another for one of them")
    rename = ",".join(
        f"{ours}=#{columns.index(theirs) + 1}" for ours, theirs in pairs.items()
    )
    rate = chosen.get("rate", "")
    return {"rename": rename} | ({"rate": rate} if rate else {})


def _training_of(runs: Iterable[Mapping[str, Any]]) -> list[tuple[Any, ...]]:
    """Return what models are identified from: the runs of training, and the windows of
    those that are split."""
    used = (run for run in runs if run["use"] in ("train", "split"))
    return [(run["file"], run["use"] == "split" and run["split"]) for run in used]


def _used(runs: Iterable[Mapping[str, Any]]) -> list[tuple[Any, ...]]:
    """Return what the runs of models and tests are, and what each is used for."""
    names = ("file", "name", "use", "split")
    return [tuple(run[x] for x in names) for run in runs if run["use"] != "wait"]


@dataclass
class RobotAndRuns(RunIssues):
    """A project whose robot and runs can be chosen, read, simulated, used and removed."""

    #: Files that have arrived and are not yet read, by name.
    arrived: dict[str, Path] = field(default_factory=dict)

    async def choose_robot(self, source: str, urdf: str | None = None) -> None:
        """Choose a robot: a built-in name, or the path of a URDF file with its shown
        name.

        RobotAndRuns and models of the previous robot are dropped.
        """
        self.names[source] = urdf or source
        answer = await self._job("Reading the robot", "robot", robot={"source": source})
        if self.robot:
            self._step_from_here("another robot")
        own = {"source": source, "own_gravity": answer["gravity"], "file": urdf}
        self.robot = answer | own
        self.runs = []
        self.remedies = []
        self.prepared = []
        self.repairs = []
        self.assigned = {}
        self.mappings = []
        self.effects = list(answer["effects"])
        self.method = DEFAULT_METHOD

    def _take_arrived(self, kind: str) -> dict[str, Path]:
        """Take the files of a kind, a key of ENDINGS, out of those that have arrived."""
        files = {k: x for k, x in self.arrived.items() if kind_of(k) == kind}
        self.arrived = {k: x for k, x in self.arrived.items() if k not in files}
        return files

    async def read_files(
        self, reading: Mapping[str, str] | None = None, again: Collection[str] = ()
    ) -> None:
        """Read the files that were dropped, and add them to the session's runs.

        reading : options of `convert` for these files; again : files of the runs that
        were read from them before.
        """
        files = self._take_arrived("runs")
        self.names |= {str(path): name for name, path in files.items()}
        listed = [{"path": str(path), "name": name} for name, path in files.items()]
        options = self.reading if reading is None else reading
        how: dict[str, Any] = {"files": listed, "options": options}
        how["assigned"] = self.assigned
        read = {str(path) for path in files.values()}
        how["taken"] = [m["name"] for m in self.refused if m["path"] not in read]
        others = [run for run in self.runs if run["file"] not in again]
        try:
            await self._take_runs("Reading measurements", "read", others, **how)
        finally:
            # Uploaded copies are deleted, except for files whose columns the person has to
            # assign now, or after a step back or forward.
            asked = self._files_of_mappings()
            for path in files.values():
                if path.parent == self.folder and str(path) not in asked:
                    path.unlink(missing_ok=True)

    def _files_of_mappings(self) -> set[str]:
        """Return the paths of all files whose columns can be assigned, now or in a state
        that a step back or forward brings back."""
        states = [state["mappings"] for _, state in (*self.past, *self.future)]
        return {
            path
            for mapping in chain(self.mappings, *states)
            for path in mapping["path"].split(FILE_SEPARATOR)
        }

    async def fetch_measured(self) -> None:
        """Load the public measurements of a built-in robot, and read them as runs."""
        name = self.robot["data"]["name"]
        answer = await self._job(f"Loading {name}'s measurements", "fetch", data=name)
        self.arrived |= {name: Path(path) for name, path in answer["files"].items()}
        await self.read_files()

    def choose_column(self, columns: Sequence[str], ours: str, theirs: str) -> None:
        """Assign a column of the refused files that have these columns to one of the
        names that a run needs.

        The form is not drawn anew: the browser shows the choice, and the next one may be
        on its way.

        Parameters
        ----------
        ours : str
            Name in a run, such as "q1" or "tau1"; "rate" for the samples a second.
        theirs : str
            Name of the column in the files, or the rate; "" for none.
        """
        self.mappings = [
            {**mapping, "chosen": {**mapping["chosen"], ours: theirs}}
            if mapping["columns"] == columns
            else mapping
            for mapping in self.mappings
        ]
        self.save()
        self.changed()

    async def leave_out(self, columns: Sequence[str]) -> None:
        """Leave the refused files with these columns out."""
        gone = [m for m in self.refused if m["columns"] == columns]
        names = formatting.words([m["name"] for m in gone])
        self._step_from_here(f"{names} left out", keeps_models=True)
        self.mappings = [m for m in self.mappings if m not in gone]

    async def read_mapped(self, columns: Sequence[str], torques: str = "") -> None:
        """Read the files with these columns again, as the person assigned them; the runs
        that were read from them before go.

        A file that is refused again keeps its choices, with the reason beside them.

        torques : name of another set of torques to take; the rest stays as it was read.
        """
        files = [m for m in self.mappings if m["columns"] == columns]
        chosen = files[0]["torques"].get(torques) or files[0]["chosen"]
        try:
            options = _options_of(columns, chosen)
        except InputError as error:
            self.mappings = [
                {**m, "reason": error.without_command} if m["columns"] == columns else m
                for m in self.mappings
            ]
            raise
        self.arrived |= {file["name"]: Path(file["path"]) for file in files}
        again = {file["run"] for file in files}
        await self.read_files({**self.reading, **options}, again)
        if all(mapping["columns"] != columns for mapping in self.refused):
            self.assigned = {**self.assigned, json.dumps(columns): options}

    async def simulate(
        self,
        effect: str,
        joints: list[int],
        level: str,
        seed: int,
        names: Sequence[str] = RUN_FILES,
    ) -> None:
        """Replace the runs by simulated ones of the robot, with one effect hidden in
        them.

        joints : numbers from 1, where the effect acts; level : how strong it is; names
        : of the simulated runs.
        """
        how = {"effect": effect, "joints": joints, "level": level, "seed": seed}
        how["names"] = list(names)
        await self._take_runs("Simulating", "simulate", [], **how)
        at = ":" + "+".join(map(str, joints)) if joints else ""
        self.hidden = f"{effect}{at}"
        hide = [] if effect == "none" else ["--hide", self.hidden]
        words = ["--level", level, "--seed", str(seed), "--out", "."]
        self.prepared = [["simulate", self.robot_word, *hide, *words]]

    async def _take_runs(
        self, title: str, job: str, before: list[dict[str, Any]], **details: Any
    ) -> None:
        """Run a job that makes runs beside the runs ``before``.

        A run whose name says "test" is used for testing, and so is one that arrives where
        there is a model: that is judged again, with the new run.
        """
        if not self.robot:
            raise InputError(
                "No robot is chosen", "choose it first, so that its joints are known"
            )
        answer = await self._job(title, job, runs=before, **details)
        new = answer["runs"][len(before) :]
        refused = [f"{why} It is left out." for why in answer.get("refused", ())]
        has_left_out = bool(refused)
        asked = {mapping["path"] for mapping in self.mappings}
        mappings = answer.get("mappings", ())
        dropped = list[str]()
        refused += [m["reason"] for m in mappings if m["path"] in asked and m["reason"]]
        if new:
            is_for_model = bool(self.history) and len(before) == len(self.runs)
            for run in new:
                if is_for_model or for_testing(run["name"]):
                    run["use"] = "test"
            answer["runs"] = self._with_questions(answer["runs"])
            new = answer["runs"][len(before) :]
            counted = f"{formatting.count(len(new), 'run')} added"
            dropped = await self._go_on_with(answer, counted)
            self._show_fit()
            self.hidden = self.hidden if before else ""
            self.prepared = [] if not before else self.prepared
            self.repairs = [] if not before else self.repairs
            for run, how in zip(new, answer.get("read", ()), strict=False):
                if how["options"]:
                    words = ["convert", how["file"]]
                    for name, value in how["options"].items():
                        words += option_words(name, value)
                    words += ["--problem", self.robot_word, "--out", run["in_commands"]]
                    self.prepared = [*self.prepared, words]
            self._choose_uses(new)
            self.effects = list(answer.get("effects", self.effects))
        self._keep_mappings(details.get("files", ()), mappings)
        remarks = [*answer.get("remarks", ())]
        if waiting := [run for run in new if run["use"] == "wait"]:
            self.new = ("check", "check")
        tested = [run["name"] for run in new if run not in waiting]
        if tested and self.history:
            remarks += [
                f"Tested on {name} as well: {self.current.error_in(name)}"
                for name in tested
            ]
        remarks += dropped
        self.say(*refused, *remarks, error=bool(refused), has_left_out=has_left_out)

    async def _judged_on(
        self, runs: Sequence[dict[str, Any]], robot: Mapping[str, Any]
    ) -> list[ModelStep]:
        """Return the models of the history judged on other runs; of another robot none,
        nor those that were identified from other runs. A model that was brought was
        identified elsewhere: it stays.

        What a diagnosis has found is of the runs that it saw: it is dropped.
        """
        kept = self.history
        same_robot = all(robot[x] == self.robot[x] for x in ("hold", "gravity"))
        if same_robot and _used(runs) == _used(self.runs):
            return kept
        if not same_robot:
            kept = []
        elif _training_of(runs) != _training_of(self.runs):
            kept = [step for step in kept if step.opened]
        if not kept:
            return []
        n_files = len([*self.folder.glob("model-*.json")])
        steps = [
            {
                "model": step.file,
                "out": str(self.folder / f"model-{k}.json"),
                "frozen": step.frozen or bool(step.opened),
            }
            for k, step in enumerate(kept, start=n_files + 1)
        ]
        title = "Testing the model" if len(steps) == 1 else "Testing the models"
        answer = await self._job(title, "judge", runs=runs, steps=steps)
        return [
            replace(step, **{**judged, "seconds": step.seconds}, findings=None)
            for step, judged in zip(kept, answer["steps"], strict=True)
        ]

    def _with_questions(self, runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return the runs, of which those wait that no model is tested on before a
        question is answered: in which unit its torque is, or what becomes of what the
        check calls an error. The others are tested on."""
        unit = runs[0].get("torque_unit")
        if unit == UNNAMED_UNIT:  # and so are those of the same logger
            runs = [{**x, "torque_unit": unit} if asks_for_unit(x) else x for x in runs]
        has_units = not any(asks_for_unit(run) for run in runs if run["use"] == "train")

        def use_of(run: Mapping[str, Any]) -> str:
            if run["use"] not in ("test", "wait"):
                return str(run["use"])
            is_open = run.get("torque_unit") != unit
            is_open |= is_refused(run) or (has_units and asks_for_unit(run))
            return "wait" if is_open and self.history else "test"

        return [{**run, "use": use_of(run)} for run in runs]

    async def _go_on_with(self, answer: Mapping[str, Any], label: str) -> list[str]:
        """Go on, as a step by a label, with what a job has answered, and with the models
        as they are judged on it; return what is said of those that are dropped."""
        models = await self._judged_on(
            answer["runs"], {**self.robot, **answer["robot"]}
        )
        if len(models) < len(self.history):
            opened = f"What was added to {models[0].opened} is" if models else ""
            dropped = [_DROPPED.format(opened or "The model is")]
        else:
            dropped = []
        self._step_from_here(label)
        self._take(answer)
        self.history = models
        return dropped

    def _show_fit(self) -> None:
        """Point the page to the fit of the models as they are judged now."""
        if self.history:
            self.new = ("identify", "fit")

    def _take(self, answer: Mapping[str, Any]) -> None:
        """Take over runs, remedies and robot as a job has answered them."""
        self.runs = answer["runs"]
        self.remedies = answer["remedies"]
        self.robot = {**self.robot, **answer["robot"]}

    def _keep_mappings(
        self, files: Sequence[Mapping[str, str]], new: Sequence[Mapping[str, Any]]
    ) -> None:
        """Keep what is known of the columns of files: what a person has chosen stays
        where they are refused again.

        files : what was read, with path and name; new : those whose columns can be chosen.
        """
        paths = {file["path"] for file in files}
        before = {m["path"]: m for m in self.mappings}
        self.mappings = [m for m in self.mappings if m["path"] not in paths]
        for file in new:
            kept = {} if file["run"] else before.get(file["path"], {})
            self.mappings.append(
                {**kept, **file, "chosen": kept.get("chosen") or file["chosen"]}
            )
        if self.refused:  # their columns are to be seen
            self.new = ("measure", "runs")

    @property
    def torque_units(self) -> list[str]:
        """Unit of each joint's torque: the robot's, or that in which the runs are used as
        they were logged."""
        units: list[str] = self.robot["units"]
        used = [run for run in self.runs if run["use"] != "wait"]
        logged = used[0].get("torque_unit") if used else ""  # older projects have none
        return [logged] * len(units) if logged else units

    @property
    def published_gains(self) -> list[str]:
        """Drive gains of the robot's joints [N m per A] that the data set of it publishes;
        none of another robot."""
        gains = (self.robot["data"] or {}).get("drive_gains") or ()
        return [f"{gain:g}" for gain in gains]

    @property
    def gains_of_namesake(self) -> tuple[str, list[str]]:
        """The data set whose robot has the name of this one, and the drive gains of its
        joints [N m per A] that it publishes; "", [] without one."""
        words = re.split(r"[^a-z0-9]+", self.robot["name"].lower())
        for known in DATASETS.values():
            if known.name in words and len(known.drive_gains) == self.robot["n"]:
                title = known.title.strip().partition(",")[0]
                return title, [f"{gain:g}" for gain in known.drive_gains]
        return "", []

    @property
    def refused(self) -> list[dict[str, Any]]:
        """The files that wait for their columns."""
        return [m for m in self.mappings if not m["run"]]

    @property
    def guessed(self) -> list[dict[str, Any]]:
        """The files whose columns were guessed, and whose run is there as it was read."""
        there = {run["file"] for run in self.runs}
        return [m for m in self.mappings if m["run"] in there]

    @property
    def computed_torque(self) -> tuple[str, dict[str, Any], str] | None:
        """The measured columns of the first run whose torque a controller computed, its
        file, and the file's name for them; None without such a run, or where its file is
        not at hand any more."""
        for run in self.runs:
            columns = run.get("rougher", "")
            for file in self.guessed if columns else ():
                for name in file["torques"]:
                    if name.startswith(f"{columns},"):
                        return columns, file, name
        return None

    def _choose_uses(self, new: Sequence[dict[str, Any]]) -> None:
        """Give each run a use, so that some data are for training and, if possible,
        some for testing.

        A single run is split into both if it is long enough. Of several that are all new
        (``new``) the last is for testing, as `check` advises, unless no other is for
        training; where their names make all of them for testing, the first is for training.
        """
        if len(self.runs) == 1:
            self.runs[0]["use"] = "split" if self.runs[0]["split"] else "train"
            return
        if not new or len(new) < len(self.runs):
            return
        uses = [run["use"] for run in new]
        if len({*uses}) == 1:
            new[0]["use"], new[-1]["use"] = "train", "test"
        elif uses[-1] == "train" and "train" in uses[:-1]:
            new[-1]["use"] = "test"

    async def use(self, file: str, use: str) -> None:
        """Use a run for "train", "test" or "split", or remove it ("").

        The models are judged again; they are dropped where other runs are for training
        now than they were identified from.
        """
        chosen = next((run for run in self.runs if run["file"] == file), None)
        if chosen is None:  # the job before has changed or removed it
            raise InputError("This run has changed", "choose its use again")
        changed = ({**run, "use": use} if run is chosen else run for run in self.runs)
        runs = [run for run in changed if run["use"]]
        if not use and {run["use"] for run in runs} <= {"test", "wait"}:
            one = "split" if len(runs) == 1 and runs[0]["split"] else "train"
            runs = [{**run, "use": one} if run is runs[0] else run for run in runs]
        if use:
            left = {"runs": runs, "remedies": self.remedies, "robot": {}}
            gone = await self._go_on_with(left, f"use of {chosen['name']}")
        else:
            left = await self._job("Checking the runs", "check_again", runs=runs)
            gone = [f"{chosen['name']} is removed: {UNDO} it back."]
            gone += await self._go_on_with(left, "a run removed")
        self.say(*gone, error=False)

    async def leave_as_read(self, chosen: Mapping[str, Any]) -> None:
        """Remember that a run is in the unit in which it was read: it may be tested on."""
        runs = [
            {**run, "stated": True} if run["file"] == chosen["file"] else run
            for run in self.runs
        ]
        left: dict[str, Any] = {"remedies": self.remedies, "robot": {}}
        left["runs"] = self._with_questions(runs)
        await self._go_on_with(left, f"{chosen['name']} left as read")
        self._show_fit()
