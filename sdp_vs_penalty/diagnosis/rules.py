"""Rules of the search that can be left out, to measure what each of them buys.

`results/challenge --without RULE` runs the same cases without one;
`results/rules/rules.md` has what came of it.
"""

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Rules:
    """Switches of the optional rules of the search; all are on by default.

    joints_alike : once there are findings, half of the prior odds go to effects that
    act on another joint already. law_misfits : errors of a finding's law are tolerated
    beside it. simplest : of candidates that do about as well the simplest one is named.
    exchange : a finding may be replaced by another effect. coarsening : evidence is
    limited to what some 3000 rows can tell, since no law is exact. curve_laws : a curve
    may follow a law of the dictionary. curves_of_two : a curve may depend on two
    variables. second_veto : certain findings are judged once more on data left out,
    without the weak ones.
    """

    joints_alike: bool = True
    law_misfits: bool = True
    simplest: bool = True
    exchange: bool = True
    coarsening: bool = True
    curve_laws: bool = True
    curves_of_two: bool = True
    second_veto: bool = True

    @classmethod
    def names(cls) -> list[str]:
        """Return the names of all rules, as the option ``--without`` takes them."""
        return [f.name for f in fields(cls)]


#: What `diagnose` does.
ALL_RULES = Rules()
