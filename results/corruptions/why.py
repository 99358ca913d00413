"""Why did the race of explanations not take the cause that was put into a log?

    python results/corruptions/why.py "soft saturation joint 3" [--arm sim5] [--data DATA]

The name is that of a corruption, or a part of it; where several match, they are listed.
For each claim that the race takes, and for the end of the race, a table ranks what
competed there: the likeliest explanations, and with a star all that name the cause. The
odds are natural logarithms against what was taken before; "prior" is the part of them that
no data give. A claim that is likely has to be confirmed by held-out parts of the log.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from types import ModuleType

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.path[0] = str(Path(__file__).parents[1])

from corruptions.arms import arm
from corruptions.bench import given
from corruptions.kinds import Corruption
from sdp_vs_penalty.checks.check import judge_facts
from sdp_vs_penalty.checks.dynamics import judge_dynamics
from sdp_vs_penalty.race import Race
from sdp_vs_penalty.race.constants import LOG_ODDS_OF_A_CLAIM
from sdp_vs_penalty.race.evidence import ViewFit
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.race import Claim, HeldRaces, RaceOutcome
from sdp_vs_penalty.race.records import Hypothesis

#: Explanations that are printed of a round, beside those that name the cause.
N_PRINTED = 8


class PrintedRaces(HeldRaces):
    """Holds a race and prints its rounds."""

    def __init__(self, corruption: Corruption) -> None:
        super().__init__()
        self.corruption = corruption

    def hold(
        self,
        logs: Sequence[Likelihood],
        kinds: tuple[ModuleType, ...],
        is_doubtful: bool,
    ) -> RaceOutcome:
        race = Race(logs, kinds, is_doubtful)
        outcome = race.run()
        titles = [f"Taken: {_words(claim)}" for claim in outcome.claims]
        fits = [*(claim.before for claim in outcome.claims), outcome.fit]
        rankings = [race.rank(fit) for fit in fits]
        for title, fit, ranking in zip([*titles, "None"], fits, rankings, strict=True):
            print(f"\n{title}\n")
            self._print_ranking(race, fit, ranking)
        fitted = [claim.hypothesis for claim in chain.from_iterable(rankings)]
        if not any(map(self._names, fitted)):
            proposed = (
                x for kind in kinds for x in kind.propose(race.all_rows, fits[0])
            )
            is_proposed = any(map(self._names, proposed))
            why = "few rows speak against it" if is_proposed else "no kind proposes it"
            print(f"\n{self.corruption.name} was not fitted to all rows: {why}.")
        return outcome

    def _print_ranking(
        self, race: Race, fit: ViewFit, ranking: Sequence[Claim]
    ) -> None:
        """Print the likeliest claims, and with a star those that name the cause."""
        print(f"{'':2}{'odds':>10} {'prior':>8} {'size':>22}  confirmed  explanation")
        for place, claim in enumerate(ranking):
            is_cause = self._names(claim.hypothesis)
            if place >= N_PRINTED and not is_cause:
                continue
            size = f"{claim.size:.4g} +- {claim.std:.2g}" if claim.std else ""
            confirmed = "unlikely"
            if claim.log_odds > LOG_ODDS_OF_A_CLAIM:
                is_confirmed = race.confirmed_claim(claim, fit) is not None
                confirmed = "yes" if is_confirmed else "no"
            print(
                f"{'*' if is_cause else '':2}{claim.log_odds:10.1f} {claim.prior:8.1f}"
                f" {size:>22}  {confirmed:9}  {_words(claim)}"
            )

    def _names(self, hypothesis: Hypothesis) -> bool:
        """Whether a hypothesis is about the cause that was put in, and its joints."""
        corruption = self.corruption
        is_of_joints = set(hypothesis.joints) == set(corruption.joints)
        is_of_kind = hypothesis.kind in corruption.causes
        return is_of_kind and (is_of_joints or not corruption.joints)


def _words(claim: Claim) -> str:
    """An explanation in words, and the part of the rows it is about."""
    words, part = claim.hypothesis.in_words, claim.hypothesis.part
    if part is None:
        return words
    run = "" if part.run is None else f" of run {part.run + 1}"
    after = "" if part.after is None else f" from {part.after:.3g} s"
    until = "" if part.until is None else f" to {part.until:.3g} s"
    return f"{words}{run}{after}{until}"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("name")
    parser.add_argument("--arm", default="sim5")
    parser.add_argument("--data", type=Path, default=Path("."))
    options = parser.parse_args(arguments)
    one = arm(options.arm, options.data)
    every = one.corruptions()
    matching = [x for x in every if x.name == options.name] or [
        x for x in every if options.name in x.name
    ]
    if len(matching) != 1:
        print(*(x.name for x in matching or every), sep="\n")
        return
    (corruption,) = matching
    problem, run = given(one, corruption)
    reports = [judge_facts(problem, part) for part in run.runs()]
    printed = judge_dynamics(problem, reports, PrintedRaces(corruption))
    print("\nThe check says:")
    for report in printed:
        for issue in report.errors_and_warnings:
            print(f"  {issue.kind} ({issue.where}): {issue.what}")


if __name__ == "__main__":
    main()
