"""Rules of the search that can be left out, to measure what each of them buys.

`results/challenge --without RULE` runs the same cases without one;
`results/rules/rules.md` has what came of it.
"""

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Rules:
    """Which rules apply.

    joints_alike : beside findings half of the odds are for effects that act on another
    joint already; free_constants : the constants of the model's own effects may move
    with a candidate; law_misfits : what a term's law gets wrong is a nuisance;
    mounting_tolerances : so is what any arm is mounted wrong; simplest : of candidates
    that do about as well the simplest is named; exchange : a term may give way to
    another; coarsening : no law is right beyond what some 3000 rows can tell;
    curve_laws : a curve may be a law of the dictionary; curves_of_two : a curve may
    depend on two variables; second_veto : confident findings are judged once more on
    data left out, without the weak ones; hums_first : lines of the torque's spectrum
    stand beside whatever is judged.
    """

    joints_alike: bool = True
    free_constants: bool = True
    law_misfits: bool = True
    mounting_tolerances: bool = True
    simplest: bool = True
    exchange: bool = True
    coarsening: bool = True
    curve_laws: bool = True
    curves_of_two: bool = True
    second_veto: bool = True
    hums_first: bool = True

    @classmethod
    def names(cls) -> list[str]:
        """Return the names of all rules, as the option ``--without`` takes them."""
        return [f.name for f in fields(cls)]


#: What `diagnose` does.
ALL_RULES = Rules()
