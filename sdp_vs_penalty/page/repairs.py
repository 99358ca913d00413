"""Changes of a tab's runs and robot: tried, made, and taken back one by one."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.api.remedies import Files, command_of, cut_copy
from sdp_vs_penalty.data.parsing import numbers
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import no_progress
from sdp_vs_penalty.page.models import Models
from sdp_vs_penalty.page.project import KEPT, TrialOutcome
from sdp_vs_penalty.page.runs import _DROPPED
from sdp_vs_penalty.records import to_json
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.robot.joint import parse_held

#: Samples of all runs with which remedies are tried before anyone asks.
_MOST_TRIED = 200_000
#: Units of torque to choose from, by the name that `convert` has.
UNITS = {"mNm": "mN m", "Ncm": "N cm", "kgfm": "kgf m", "lbfin": "lbf in"}
#: The same of positions.
ANGLES = {"deg": "degrees", "mrad": "mrad"}


#: What is done while a change is made, by its verb.
_TITLES = {
    "transform": "Repairing the log",
    "read": "Reading the log anew",
    "cut": "Leaving rows out",
    "hold": "Holding the joints",
    "mount": "Setting gravity",
}


def is_leaving_out(change: Mapping[str, Any]) -> bool:
    """Whether a change leaves a whole run out."""
    return change["verb"] == "cut" and "spans" not in change["arguments"]


def _words_of_reading(change: Mapping[str, Any]) -> str:
    """Return in words the units that a change reads columns in, which a person has
    named; "" of another change, and of one that says its factors itself."""
    texts = list[str]()
    if change["words"].startswith("multiply"):
        return ""
    for column, unit in change["arguments"].get("scale", {}).items():
        name = {"tau": "the torque", "q": "positions"}.get(column, column)
        gains = str(unit or "").replace(":", ", ")
        named = {key.lower(): words for key, words in (UNITS | ANGLES).items()}
        is_factor = gains[:1].isdigit() or gains[:1] in ("-", ".")
        texts.append(
            f"multiply {name} by {gains}"
            if is_factor
            else f"read {name} in {named.get(gains.lower(), gains)}"
        )
    return formatting.words(texts) if texts else ""


@dataclass
class Repairs(Models):
    """A project whose runs and robot can be repaired, and each repair taken back."""

    #: Changes of remedies that are being tried, or wait for it.
    untried: list[dict[str, Any]] = field(default_factory=list)
    #: What the changes answered that were tried on the runs as they are, by the request.
    foreseen: dict[str, dict[str, Any]] = field(default_factory=dict)

    async def _foresee(self) -> None:
        """Try the remedies of the runs beside everything else, and keep what each would
        do to the error on motion left out, and what it would answer."""
        untried = [
            change
            for change in (x.change.to_dict() for x in self.remedies if not x.is_tried)
            if change["verb"] != "record"
            and not is_leaving_out(change)
            and all(change["arguments"].get("scale", {"": "1"}).values())
        ]
        n_samples = sum(run["samples"] for run in self.runs)
        if not untried or n_samples > _MOST_TRIED or self.model is not None:
            return
        self.untried = untried
        self.changed()
        try:
            await self._try_changes()
        finally:
            self.untried = []

    async def _try_changes(self) -> None:
        """Try the untried changes one by one, and keep what each would do."""
        self.foreseen = {}
        for change in self.untried:
            request = self._change_request(change)
            try:
                answer = await self._answer(request, no_progress, is_aside=True)
            except InputError as error:
                self._keep_outcome(change, refused=error.without_command)
            else:
                self.foreseen[json.dumps(to_json(request))] = answer
                effect = TrialOutcome.from_dict(answer["effect"])
                self._keep_outcome(change, effect=effect)
            self.untried = self.untried[1:]
            self.save()
            self.changed()

    def _keep_outcome(self, change: Mapping[str, Any], **outcome: Any) -> None:
        """Keep what a change of a remedy would do (effect=), or why not (refused=)."""
        made = Change.from_dict(change)
        self.remedies = [
            replace(x, **outcome) if x.change == made else x for x in self.remedies
        ]

    def outcome_of(self, change: Change) -> TrialOutcome | None:
        """Return what a remedy's change would do to the error on motion left out, or why
        it is refused; None where it was not tried."""
        remedies = (x for x in self.remedies if x.change == change)
        return next((x.outcome for x in remedies), None)

    async def mount(self, gravity: str) -> None:
        """Set gravity in the robot's base frame, "x,y,z" [m/s^2]."""
        vector = numbers("gravity", gravity, 3)
        words = f"gravity {gravity}"
        await self.apply(Change("mount", words, {"gravity": vector}).to_dict())

    async def hold(self, positions: str) -> None:
        """Hold joints that do not move, "finger_joint=0"."""
        words = f"{positions} held"
        held = {"positions": parse_held(positions)}
        await self.apply(Change("hold", words, held).to_dict())

    def before_repair(self, k: int) -> dict[str, Any] | None:
        """Return what was there before the k-th repair (from 0); None where more than
        repairs has changed the runs since, or that was too long ago."""
        now = {name: getattr(self, name) for name in KEPT}
        states = [*(kept for _, kept in self.past), now]
        begins = [n for n, kept in enumerate(states) if len(kept["repairs"]) == k]
        states = states[begins[-1] :] if begins else []
        is_kept = all(
            len(after["repairs"]) == len(before["repairs"]) + 1
            if after["repairs"] != before["repairs"]
            else after["runs"] == before["runs"]
            for before, after in pairwise(states)
        )
        is_known = all(change["verb"] for _, _, change in self.repairs)
        return states[0] if states and is_kept and is_known else None

    async def take_back(
        self, k: int, instead: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        """Take the k-th repair (from 0) back, or make others instead of it; those after
        it are made again."""
        before = self.before_repair(k)
        if before is None:
            raise InputError("This repair cannot be taken back alone", "press Undo")
        again = [*instead, *(change for _, _, change in self.repairs[k + 1 :])]
        had_model = self.model is not None
        self._step_from_here(f"taken back: {self.repairs[k][0]}")
        for name, value in before.items():
            setattr(self, name, value)
        for change in again:
            await self.apply(change)
        if had_model and self.model is None:
            self.say(_DROPPED.format("The model is"), error=False)

    def _earlier_unit(self, change: Mapping[str, Any]) -> tuple[int, dict[str, Any]]:
        """Return the repair (from 0) that has set the unit of the channels that a change
        reads, and what else that repaired; -1 where none has."""
        channels = {*change["arguments"].get("scale", {})}
        for k, (_, _, made) in enumerate(self.repairs):
            arguments = made["arguments"]
            words = arguments.get("apply", ())
            others = [word for word in words if word != "unit:tau"]
            is_same = not channels.isdisjoint(arguments.get("scale", {}))
            is_same |= "tau" in channels and len(others) < len(words)
            if is_same and self.before_repair(k) is not None:
                return k, {**made, "arguments": {"apply": others}} if others else {}
        return -1, {}

    async def read_in_unit(self, change: Mapping[str, Any]) -> None:
        """Read runs in the unit that a person names of the log: in place of the unit that
        an earlier repair has taken it for."""
        k, others = self._earlier_unit(change)
        if k < 0:
            await self.apply(change)
        else:
            await self.take_back(k, [x for x in (others, change) if x])

    async def apply(self, change: Mapping[str, Any]) -> None:
        """Do what a remedy says: to the runs and the robot, to the model, or a motion to
        record.

        change : as the remedy's JSON has it.
        """
        verb = change["verb"]
        if verb in ("add", "reset"):
            await self._add(change)
            return
        named = change["arguments"].get("run")
        files = [run["file"] for run in self.runs if named in (None, run["name"])]
        if is_leaving_out(change):
            await self.use(files[0], "")
        elif verb == "read":
            one = {k: x for k, x in change["arguments"].items() if k != "run"}
            await self._change({**change, "arguments": one}, files)
        elif verb != "record":
            await self._change(change)
        if verb != "record" and not is_leaving_out(change):
            self.repairs[-1][2] = {**change}

    async def _change(
        self, change: Mapping[str, Any], files: Collection[str] | None = None
    ) -> None:
        """Change runs and robot, and check them again; what it did to the error on data
        left out is said. Models stay that the change leaves their robot and runs.

        files : the runs that are changed; None: all.
        """
        request = self._change_request(change, files)
        words = request["change"]["words"]
        self._doing(title=_TITLES[change["verb"]], status="")
        try:
            known = self.foreseen.get(json.dumps(to_json(request)))
            answer = known or await self._run(request)
        except InputError as error:
            self._keep_outcome(change, refused=error.without_command)
            raise
        commands = self._commands_of(change, request["files"])
        answer = {**answer, "runs": self._with_questions(answer["runs"])}
        done = words
        if faults := self.faults_in_words(change):  # the words count them
            done = f"repaired: {faults}"
        elif len(request["files"]) < len(self.runs):
            names = [r["name"] for r in self.runs if r["file"] in request["files"]]
            done = f"{words} in {formatting.words(names)}"
        columns = [x["columns"] for x in self.runs if x["file"] in request["files"]]
        dropped = await self._go_on_with(answer, done)
        scale = change["arguments"].get("scale", {})
        for key in {json.dumps(names) for names in columns if names and scale}:
            texts = ",".join(f"{name}={unit}" for name, unit in scale.items())
            options = {**self.assigned.get(key, {}), "scale": texts}
            self.assigned = {**self.assigned, key: options}
        if change["verb"] in ("transform", "read", "cut"):
            self.prepared = [*self.prepared, *commands]
        self.new = ("check", "check")
        self.seen_issues = self.kinds_of_issue
        self.repairs = [*self.repairs, [done, answer["effect"], change]]
        self.say(*dropped, error=False)

    def _commands_of(
        self, change: Mapping[str, Any], files: Collection[str]
    ) -> list[list[str]]:
        """Return the words of the commands that make a change of these runs: one for
        all, or, where each is read anew, one a run."""
        written = {run["name"]: run["in_commands"] for run in self.runs}
        arguments = change["arguments"]
        if "run" in arguments:
            arguments = {**arguments, "run": written[arguments["run"]]}
        one = Change.from_dict({**change, "arguments": arguments})
        checks = [self._check_command]
        if change["verb"] == "read":
            names = [run["in_commands"] for run in self.runs if run["file"] in files]
            checks = [replace(checks[0], runs=[name]) for name in names]
        commands = [command_of(one, Files(check)) for check in checks]
        return [words for words in commands if words is not None]

    def _change_request(
        self, change: Mapping[str, Any], files: Collection[str] | None = None
    ) -> dict[str, Any]:
        """Return the request for a change of robot and runs, with what commands call the
        runs afterwards: as the command that does the same."""
        command = self._check_command
        names = [run["in_commands"] for run in self.runs]
        chosen = [run["file"] for run in self.runs]
        chosen = [file for file in chosen if files is None or file in files]
        has_commands = bool(self._commands_of(change, chosen))
        if change["verb"] == "transform" and has_commands and len(names) > 1:
            names = [f"{command.copy}/{Path(name).stem}.csv" for name in names]
        elif change["verb"] in ("transform", "read") and has_commands:
            names = [
                str(replace(command, runs=[run["in_commands"]]).copy)
                if run["file"] in chosen
                else run["in_commands"]
                for run in self.runs
            ]
        elif change["verb"] == "cut":
            cut = change["arguments"]["run"]
            places = enumerate(run["name"] == cut for run in self.runs)
            names = [
                str(cut_copy(names[k])) if is_cut else names[k] for k, is_cut in places
            ]
        change = {**change, "words": _words_of_reading(change) or change["words"]}
        return self._request("change", change=change, files=chosen, names=names)
