"""Make this folder again: python results/bench/make.py [--only KIND] [--out FOLDER]

Check, identify and diagnose on logs whose truth is known. Logs are written first, each
with its truth beside it; what is judged already is not judged again, so that a run that
was stopped goes on. With --out FOLDER another version is judged beside this one.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
HERE = Path(__file__).parent
sys.path[0] = str(HERE.parent)

import pandas

from bench import greedy, judge, library_race, mujoco_worlds, situations, sources
from bench.judge import RAISED, Row
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.paper.provenance import write_note
from sdp_vs_penalty.results.table import markdown_lines

SEEDS = 1, 2
#: Arms whose logs are corrupted: of two or three joints, and of four to seven.
CORRUPTED = ("small31", "small32", "drawn33")
WORLDS = 1_030_000
#: A log's name, and what writes it into a folder.
Log = tuple[str, Callable[[Path], None]]


def everyday() -> list[Log]:
    """Situations of our own: two seeds each."""
    return [
        (f"{name}-{seed}", partial(situations.make, name, seed))
        for name in situations.SITUATIONS
        for seed in SEEDS
    ]


def mujoco() -> list[Log]:
    """Arms under a controller."""
    names = mujoco_worlds.WORLDS
    return [(f"{x}-1", partial(mujoco_worlds.make, x, 1)) for x in names]


def corrupted() -> list[Log]:
    """Logs that were corrupted on purpose."""
    names = sources.corruption_names(CORRUPTED)
    return [(x, partial(sources.make_corruption, x)) for x in names]


def worlds() -> list[Log]:
    """Worlds of the challenge, with nuisances."""
    names = sources.world_names(WORLDS)
    return [(x, partial(sources.make_world, x)) for x in names]


def real() -> list[Log]:
    """Real arms; nothing where SDP_VS_PENALTY_DATA names no measurements."""
    has_data = "SDP_VS_PENALTY_DATA" in os.environ
    names = sources.ARMS if has_data else ()
    return [(x, partial(sources.make_real, x)) for x in names]


#: The program's own verbs, the baseline, and the race in place of `diagnose`.
ENGINES = {
    "bench": judge.said_of,
    "greedy": greedy.said_of,
    "library_race": library_race.said_of,
}
KINDS = {f.__name__: f for f in (everyday, mujoco, corrupted, worlds, real)}


def run(only: Sequence[str], engine: str, out: Path, logs: Path) -> None:
    """Judge the logs of some kinds that the table in ``out`` does not have yet."""
    table = out / f"{engine}.csv"
    rows = read(table)
    known = {(row.kind, row.log) for row in rows}
    for kind in only:
        for name, make in KINDS[kind]():
            if (kind, name) in known:
                continue
            folder = logs / kind / name
            if not (folder / "truth.json").exists():
                make(folder)
            rows.append(judge.judge(kind, folder, ENGINES[engine]))
            print(*list(asdict(rows[-1]).values())[:6], sep=" | ", flush=True)
            frame = pandas.DataFrame([asdict(row) for row in rows])
            write_text(table, frame.to_csv(index=False, lineterminator="\n"))
    write_text(out / f"{engine}.md", markdown(rows))
    command = ["results/bench/make.py", "--engine", engine]
    write_note(out, [command], sum(row.seconds for row in rows))


def read(path: Path) -> list[Row]:
    """Read the rows of a table that was begun."""
    if not path.exists():
        return []
    table = pandas.read_csv(path, keep_default_na=False, dtype=str)
    table["seconds"] = table["seconds"].astype(float)
    names = [field.name for field in fields(Row)]
    return [Row(*values) for values in table[names].itertuples(index=False)]


def counts(rows: Sequence[Row]) -> list[str]:
    """The cells of some logs in the table."""
    outcomes = [row.outcome for row in rows]
    ratios = [float(r.largest_ratio) for r in rows if r.mean_ratio]
    numbers = [
        len(rows),
        *(outcomes.count(x) for x in ("right", "possible", "missed")),
        sum(bool(row.false_check or row.false_diagnose) for row in rows),
        sum(bool(row.false_check) for row in rows),
        sum(bool(row.false_diagnose) for row in rows),
        sum(bool(row.contradiction) for row in rows),
        f"{sum(x > RAISED for x in ratios)} of {len(ratios)}",
        f"{sum(row.seconds for row in rows):.0f}",
    ]
    return [str(x) for x in numbers]


def markdown(rows: Sequence[Row]) -> str:
    """The table by kind, and each log that is not right."""
    heads = ["logs", "number", "right", "possible", "missed", "with a false word"]
    heads += ["of check", "of diagnose", "contradictions", "a joint raised by 5 %"]
    heads += ["CPU [s]"]
    groups = {kind: [row for row in rows if row.kind == kind] for kind in KINDS}
    groups |= {"all": list(rows)}
    lines = markdown_lines(heads, [[k, *counts(some)] for k, some in groups.items()])
    text = ["# What is said of logs whose truth is known", "", *lines, ""]
    for kind, some in groups.items():
        wrong = [row for row in some if kind != "all" and is_wrong(row)]
        text += [f"## {kind}", ""]
        for row in wrong:
            false = "; ".join(filter(None, (row.false_check, row.false_diagnose)))
            said = f"false: {false}" if false else f"said: {row.said or 'nothing'}"
            text.append(f"- {row.log}: {row.outcome}; {said}")
        text += ["" if wrong else "none", ""]
    return "\n".join(text[:-3]) + "\n"


def is_wrong(row: Row) -> bool:
    """Whether a log is not named rightly, or something false is said of it."""
    return row.outcome != "right" or bool(row.false_check or row.false_diagnose)


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=[*KINDS], default=[*KINDS])
    parser.add_argument("--engine", choices=[*ENGINES], default="bench")
    parser.add_argument("--out", type=Path, default=HERE)
    parser.add_argument("--logs", type=Path, default=HERE / "logs")
    options = parser.parse_args()
    run(options.only, options.engine, options.out, options.logs)


if __name__ == "__main__":
    main()
