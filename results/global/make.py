"""Make this folder's table and figure: python results/global/make.py [--budget paper]
[--jobs N]

Needs SDP_VS_PENALTY_DATA for the measured rows, the extra [plot] for the figure and
[solvers] for the column of CVXPY. The table alone: sdp-vs-penalty tables global.
"""

import argparse
from pathlib import Path

import matplotlib

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.parallel import Workers
from sdp_vs_penalty.research.figures import save
from sdp_vs_penalty.research.figures.global_optimum import draw_global_optima
from sdp_vs_penalty.research.tables import build_tables
from sdp_vs_penalty.research.tables.global_optimum import penalised_optima
from sdp_vs_penalty.research.tables.study import Study

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", default="quick", choices=("quick", "paper"))
    parser.add_argument("--jobs", default=1, type=int)
    options = parser.parse_args()
    matplotlib.use("Agg")
    for name, folder in (("panda", HERE), ("two_link", HERE / "two_link")):
        study = Study(load_problem(name), options.budget, workers=Workers(options.jobs))
        folder.mkdir(exist_ok=True)
        (table,) = build_tables(["global"], study)
        table.write(folder)
        if name == "panda":
            label = "simulated" if study.run is None else "measured"
            searched = [
                found for found in study.once(penalised_optima) if found.label == label
            ]
            title = "Global optimum of the published penalised objective, Panda"
            save(draw_global_optima(searched, title), HERE / "optimum_over_weight")


if __name__ == "__main__":
    main()
