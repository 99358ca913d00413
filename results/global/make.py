"""Make this folder again: python results/global/make.py [--searches --budget single --runs 9 --jobs 2]

Needs SDP_VS_PENALTY_DATA for the measured rows and the extra [plot] for the figures. The
certified tables take a minute. --searches makes
annealing_runs.csv anew, which is drawn as it lies here otherwise; with --budget single, --runs
says how many long runs of annealing the measured rows get, a minute each. Every solve and every
step of annealing is kept (SDP_VS_PENALTY_CACHE): what was stopped goes on where it was.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import matplotlib
import pandas

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.paper.figures import save
from sdp_vs_penalty.paper.figures.penalty import draw_global_optima, draw_retrieved
from sdp_vs_penalty.paper.provenance import write_note
from sdp_vs_penalty.paper.tables import build_tables
from sdp_vs_penalty.paper.tables.penalty import retrieval, search_table
from sdp_vs_penalty.paper.tables.study import BUDGETS, Study
from sdp_vs_penalty.paper.tables.table import exact_csv
from sdp_vs_penalty.parallel import Workers

HERE = Path(__file__).parent
FOLDERS = {"panda": HERE, "two_link": HERE / "two_link"}
RUNS = "annealing_runs.csv"
TITLE = "Global optimum of the published penalised objective, Panda"


def make(study: Study, folder: Path, with_searches: bool) -> None:
    """The table of a problem, and every run of its searches."""
    folder.mkdir(exist_ok=True)
    (table,) = build_tables(["global"], study)
    table.write(folder)
    if with_searches:
        runs = search_table(study, table.frame)
        write_text(folder / RUNS, exact_csv(runs.astype(object)))


def draw(study: Study) -> None:
    """Optimum, violation and annealing's runs over the weight."""
    label = "simulated" if study.run is None else "measured"
    optima = pandas.read_csv(HERE / "table_global.csv")
    runs = pandas.read_csv(HERE / RUNS)
    figure = draw_global_optima(optima[optima["data"] == label], runs, TITLE)
    save(figure, HERE / "optimum_over_weight")


def draw_p_hat(study: Study) -> None:
    """The published links beside the optimum of the authors' own objective."""
    save(draw_retrieved(study.once(retrieval)), HERE / "p_hat")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--searches", action="store_true")
    parser.add_argument("--budget", default="quick", choices=list(BUDGETS))
    parser.add_argument("--runs", type=int)
    parser.add_argument("--jobs", default=1, type=int)
    options = parser.parse_args()
    matplotlib.use("Agg")
    for name, folder in FOLDERS.items():
        workers = Workers(options.jobs)
        study = Study(load_problem(name), options.budget, workers=workers)
        if options.runs and study.run is not None:
            study.effort = replace(study.effort, annealing_runs=options.runs)
        make(study, folder, options.searches and name == "panda")
        if name == "panda":
            draw(study)
            draw_p_hat(study)
    command = ["results/global/make.py", *sys.argv[1:]]
    write_note(HERE, [command], time.process_time())


if __name__ == "__main__":
    main()
