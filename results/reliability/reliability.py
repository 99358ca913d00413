"""How often is what the check calls certain, or likely, right?

    python results/reliability/reliability.py results/corruptions_claims.csv results/worlds_claims.csv

Reads the claims that the other benchmarks of the check have written: one row for each
error or warning, with its first word ("certain", "likely" or "possible") and whether it
is right. A claim about a corrupted log is right if it names the corruption (and the
joint), or says that something is wrong without naming a cause. A claim about a log to
which nothing was done is right only if the arm has that very thing.
Writes reliability.md.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

if __name__ == "__main__":  # for this process and its workers
    sys.path[0] = str(Path(__file__).parents[1])

import pandas
from challenge.judge import share

from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.results.table import markdown_lines

#: The words of certainty, the strongest first.
WORDS = "certain", "likely", "possible"
#: What is true of a motion, whatever was done to its log.
OF_THE_MOTION = "poor excitation", "idle joints", "lockstep motion"


@dataclass(frozen=True)
class Claim:
    """source : the benchmark's name for a kind of log; word : of certainty."""

    source: str
    case: str
    kind: str
    where: str
    nature: str
    word: str
    is_right: bool


def claim(source: str, case: str, issue: Issue, is_right: bool) -> Claim:
    """One issue of a log as a claim."""
    word = issue.certainty.grade
    return Claim(source, case, issue.kind, issue.where, issue.nature, word, is_right)


def write_claims(claims: Iterable[Claim], path: Path) -> None:
    """One row a claim."""
    table = pandas.DataFrame([asdict(claim) for claim in claims])
    write_text(path, table.to_csv(index=False, lineterminator="\n"))


def read_claims(path: Path) -> list[Claim]:
    """The claims of a table that has been begun."""
    if not path.exists() or not path.read_text().strip():
        return []
    table = pandas.read_csv(path, keep_default_na=False)
    names = [field.name for field in fields(Claim)]
    return [Claim(*values) for values in table[names].itertuples(index=False)]


def table_of(claims: pandas.DataFrame) -> list[str]:
    """The reliability table in Markdown: sources down, words across."""
    rows = []
    for source in [*dict.fromkeys(claims["source"]), "all"]:
        part = claims if source == "all" else claims[claims["source"] == source]
        cells = [source]
        for word in WORDS:
            right = part[part["word"] == word]["is_right"]
            if not len(right):
                cells.append("")
                continue
            percent, interval = share(int(right.sum()), len(right))[1:]
            cells.append(f"{int(right.sum())} of {len(right)}, {percent} ({interval})")
        rows.append(cells)
    return markdown_lines(["logs", *(f"{word}: right" for word in WORDS)], rows)


def markdown(claims: pandas.DataFrame, command: str) -> str:
    """The table, and every claim that is wrong."""
    wrong = claims[~claims["is_right"]]
    lines = [
        "# How reliable is what the check claims?",
        "",
        f"Made by `{command}`.",
        "",
    ]
    lines += table_of(claims)
    lines += ["", "In brackets Wilson's 95 % interval.", "", "## Wrong claims", ""]
    lines += [
        f"- {row.source}, {row.case}: {row.word}, {row.kind} ({row.where})"
        for row in wrong.itertuples()
    ] or ["none"]
    return "\n".join([*lines, ""])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("claims", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=Path("results"))
    options = parser.parse_args(arguments)
    claims = pandas.concat([pandas.read_csv(path) for path in options.claims])
    names = " ".join(f"results/{path.name}" for path in options.claims)
    text = markdown(claims, f"python results/reliability/reliability.py {names}")
    write_text(options.out / "reliability.md", text)


if __name__ == "__main__":
    main()
