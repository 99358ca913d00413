"""What the check says of a tab's runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.measurements import UNNAMED_UNIT
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page.job_queue import JobQueue
from sdp_vs_penalty.page.spoken import spoken
from sdp_vs_penalty.problem.check_command import CheckCommand
from sdp_vs_penalty.results.issue import StoredIssue
from sdp_vs_penalty.results.remedy import Change

#: Letters of a place that is named beside a fault among others.
_MOST_OF_PLACE = 20


def is_refused(run: Mapping[str, Any]) -> bool:
    """Whether the check calls something in a run an error."""
    return any(issue.severity == "error" for issue in run["findings"])


def asks_for_unit(run: Mapping[str, Any]) -> bool:
    """Whether the check asks in which unit the torques of a run are, and nobody has
    answered: by a unit, or by a model without units."""
    is_answered = run.get("stated") or run.get("torque_unit") == UNNAMED_UNIT
    return not is_answered and any(map(is_unit_asked, run["findings"]))


def is_unit_asked(issue: StoredIssue) -> bool:
    """Whether an issue asks in which unit all torques are."""
    return any(is_of_all_torques(remedy.change) for remedy in issue.remedies)


def is_of_all_torques(change: Change) -> bool:
    """Whether a change reads all torques in a unit that only the person knows."""
    return change.arguments.get("scale") == {"tau": None}


@dataclass
class RunIssues(JobQueue):
    """A project with what the check says of its runs."""

    @property
    def is_unit_open(self) -> bool:
        """Whether nobody has answered in which unit the torques of a run in use are."""
        used = [run for run in self.runs if run["use"] != "wait"]
        units = [run.get("torque_unit") for run in used]
        return UNNAMED_UNIT in units or any(map(asks_for_unit, used))

    @property
    def has_gains_by_size(self) -> bool:
        """Whether the torques of a run in use are in N m by gains that nobody has stated."""
        used = [run for run in self.runs if run["use"] != "wait"]
        return any(run.get("gains_by_size") for run in used)

    @property
    def is_unit_left_open(self) -> bool:
        """Whether the person has answered that the torques' unit is not known: by gains
        that fit the masses, or by a model without units."""
        used = [run for run in self.runs if run["use"] != "wait"]
        is_unnamed = any(run.get("torque_unit") == UNNAMED_UNIT for run in used)
        return (is_unnamed or self.has_gains_by_size) and not any(
            map(asks_for_unit, used)
        )

    @property
    def meaningless(self) -> list[str]:
        """The errors that the data check found in the training runs, a sentence each.

        With any of them, a model identified from these runs would be meaningless.
        """
        return [
            spoken(f"{run['name']}: {f.what.rstrip('.')}: {f.remedy}")
            for run in self.runs
            if run["use"] in ("train", "split")
            for f in run["findings"]
            if f.severity == "error"
        ]

    @property
    def differing_runs(self) -> list[dict[str, Any]]:
        """The runs for training that the check calls another arm or load than the others;
        none where no other is left."""
        training = [run for run in self.runs if run["use"] == "train"]
        differing = [
            run
            for run in training
            if any(issue.is_another_arm for issue in run["findings"])
        ]
        return differing if len(differing) < len(training) else []

    @property
    def warnings(self) -> list[StoredIssue]:
        """What the check found in the runs; notes do not count."""
        issues = [issue for run in self.runs for issue in run["findings"]]
        return [issue for issue in issues if issue.severity != "note"]

    @property
    def issues(self) -> list[tuple[StoredIssue, list[dict[str, Any]]]]:
        """Each issue of the check once, with the runs that have it.

        Issues are the same if kind, place and remedy are equal; the first run's sentence
        stands for all. Example: [(the issue "torque sign", [run 1, run 2])].
        """
        groups = dict[tuple[str, str, str], tuple[StoredIssue, list[dict[str, Any]]]]()
        for run in self.runs:
            for issue in run["findings"]:
                key = (issue.kind, issue.where, issue.remedy)
                groups.setdefault(key, (issue, []))[1].append(run)
        return list(groups.values())

    @property
    def kinds_of_issue(self) -> list[str]:
        """Kinds of what the check found in the runs, each once."""
        return sorted({issue.kind for issue in self.warnings})

    @property
    def kinds_to_see(self) -> set[str]:
        """Kinds of what the check found that asks for something, and that the person was
        not led to."""
        asking = {issue.kind for issue in self.warnings if issue.needs_action}
        return asking - {*self.seen_issues}

    def see_issues(self) -> None:
        """Remember that the person was led to the issues of the check."""
        self.seen_issues = self.kinds_of_issue
        self.save()
        self.changed()

    def units_as_logged(self, run: str) -> tuple[str, str]:
        """Return the units of a run's positions and of its torque where these are not the
        robot's; "" where they are."""
        (one,) = (x for x in self.runs if x["name"] == run)
        units = [issue.position_unit for issue in one["findings"]]
        position = next(filter(None, units), "")
        torque = one.get("torque_unit") or ("A?" if asks_for_unit(one) else "")
        return position, torque

    def faults_in_words(self, change: Mapping[str, Any]) -> str:
        """What a change repairs that makes several repairs, in a few words each: "torque
        sign (joint 4) in run2.csv"; "" of one that is a single issue's."""
        faults_by_runs = dict[str, list[str]]()
        made = set(change["arguments"].get("apply", ()))
        for issue, runs in self.issues:
            repairs = [remedy.change for remedy in issue.remedies]
            if change["verb"] != "transform" or Change.from_dict(change) in repairs:
                return ""
            words = [x.arguments["apply"] for x in repairs if "apply" in x.arguments]
            if not any(made.issuperset(word) for word in words):
                continue
            names = formatting.words([run["name"] for run in runs])
            names = "all runs" if len(runs) == len(self.runs) > 1 else names
            where = issue.where if len(issue.where) < _MOST_OF_PLACE else ""
            fault = f"{issue.kind} ({where})".removesuffix(" ()")
            faults_by_runs.setdefault(names, []).append(fault)
        found = faults_by_runs.items()
        return "; ".join(f"{formatting.words(x)} in {names}" for names, x in found)

    @property
    def _check_command(self) -> CheckCommand:
        """The `check` of the runs, as a terminal needs it."""
        gravity = self.robot["gravity"]
        is_own = gravity == self.robot["own_gravity"]
        return CheckCommand(
            problem=self.robot_word,
            runs=[run["in_commands"] for run in self.runs] or ["run.csv"],
            hold=self.robot["hold"] or None,
            gravity=None if is_own else ",".join(f"{g:g}" for g in gravity),
        )

    def _refuse_meaningless(self) -> None:
        """Raise InputError if the check found errors and the person did not overrule
        it.
        """
        if self.meaningless and not self.anyway:
            raise InputError(
                self.meaningless[0].rstrip("."),
                'repair it under Check, or press "Identify anyway"',
            )
