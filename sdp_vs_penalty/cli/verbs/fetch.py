from pathlib import Path

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import command_line


def verb(names: list[str] | None = None, folder: Path | None = None) -> None:
    """Download public measurements and write them as RUN.csv files; prints their paths.

    Example: sdp-vs-penalty fetch emps

    names [panda|ur10e|emps|tx40] ...: Data sets; default: all.
    --folder: Folder for the files; default: the user's cache.
    """
    from sdp_vs_penalty.data.datasets import DATASETS, cache_folder, dataset
    from sdp_vs_penalty.data.datasets import fetch as fetch_dataset

    for name in [dataset(name).name for name in names or DATASETS]:
        with console.progress(f"fetching {name}"):
            paths = fetch_dataset(name, folder)
        for path in paths:
            console.say(str(path))
        robot = dataset(name).problem
        line = formatting.command("check", robot, "--data", str(paths[0]))
        console.hint(f"Next: {line}")
    target = folder or cache_folder()
    variable = command_line([f"SDP_VS_PENALTY_DATA={target}"])
    console.hint(f"sdp-vs-penalty: for the tables, set {variable}")
