"""Rules of the search that can be left out, to measure what each of them buys.

`results/challenge --without RULE` runs the same cases without one;
`results/rules/rules.md` has what came of it.
"""

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Rules:
    """Switches of the optional rules of the search; all are on by default."""

    #: Errors of a finding's law are tolerated beside it.
    law_misfits: bool = True
    #: Of candidates that do about as well the simplest one is named.
    simplest: bool = True
    #: A finding may be replaced by another effect.
    exchange: bool = True
    #: Evidence is limited to what some 3000 rows can tell, since no law is exact.
    coarsening: bool = True
    #: A curve may follow a law of the dictionary.
    curve_laws: bool = True
    #: A curve may depend on two variables.
    curves_of_two: bool = True
    #: Certain findings are judged once more on data left out, without the weak ones.
    second_veto: bool = True

    @classmethod
    def names(cls) -> list[str]:
        """Return the names of all rules, as the option ``--without`` takes them."""
        return [f.name for f in fields(cls)]


#: What `diagnose` does.
ALL_RULES = Rules()
