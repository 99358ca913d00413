"""Files as they should be, which attacks change."""

import json
import shutil
from pathlib import Path

from mutations import sound_meshes
from small_runs import small_run, write_bag

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import save
from sdp_vs_penalty.files import problems_folder


def write_sound_files(folder: Path) -> None:
    """One good file of each kind; two of runs."""
    problem = sdp.load_problem("two_link")
    run = small_run(problem)
    for suffix in (".csv", ".npz", ".mat", ".parquet"):
        save(run, folder / f"run{suffix}")
    save(small_run(problem, seed=1), folder / "second.csv")
    for suffix in (".mcap", ".db3"):
        write_bag(folder / "bag", run, mcap=suffix == ".mcap")
        (file,) = (folder / "bag").glob(f"*{suffix}")
        file.rename(folder / f"run{suffix}")
        shutil.rmtree(folder / "bag")
    model = sdp.identify(problem, run, proof=folder / "proof.json")
    model.save(folder / "model.json")
    sdp.export(model, folder / "arm.urdf")
    findings = json.dumps(sdp.diagnose(model, run).to_dict())
    (folder / "findings.json").write_text(findings)
    home = problems_folder() / "two_link"
    (folder / "problem.toml").write_bytes((home / "problem.toml").read_bytes())
    for suffix, content in sound_meshes().items():
        (folder / f"mesh{suffix}").write_bytes(content)
