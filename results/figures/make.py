"""Make this folder again: python results/figures/make.py

Needs the extra [plot], and SDP_VS_PENALTY_DATA for what is measured. joint_7.png and
data.png are drawn from results/tables, with the README's comparison.
"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder, program

HERE = Path(__file__).parent

if __name__ == "__main__":
    make_folder(
        HERE,
        program("figures", "--out", "results/figures"),
        ["results/tables/update_readme.py"],
    )
