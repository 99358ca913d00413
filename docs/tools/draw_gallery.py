"""Make the small pictures of docs/gallery/README.md: one figure of each page.

    python docs/tools/draw_gallery.py [PAGE ...]

Runs the scripts of docs/gallery (a minute each), and reads the notebooks' outputs. Needs
the extra [docs].
"""

from __future__ import annotations

import base64
import io
import json
import os
import runpy
import sys
from pathlib import Path

import matplotlib as mpl
from PIL import Image

ROOT = Path(__file__).parents[2]
GALLERY = ROOT / "docs" / "gallery"
#: Of each page the figure that is shown, from 0.
SHOWN = {
    "own_robot": 2,
    "students_day": 0,
    "panda_hysteresis": 2,
    "payload": 1,
    "no_torque": 0,
    "solvers": 0,
    "penalty_optimum": 0,
    "coupled_wrist": 2,
    "bag_to_urdf": 0,
}
#: Width of a picture [px], and its colours.
WIDTH = 420
COLOURS = 200


def figures_of_script(path: Path) -> list[Image.Image]:
    """Run a page; return its figures."""
    import matplotlib.pyplot as plt

    os.chdir(ROOT)  # where the pages find what they read
    runpy.run_path(str(path))
    pictures = []
    for number in plt.get_fignums():
        buffer = io.BytesIO()
        plt.figure(number).savefig(buffer, dpi=110, bbox_inches="tight")
        pictures.append(Image.open(buffer).convert("RGB"))
    plt.close("all")
    return pictures


def figures_of_notebook(path: Path) -> list[Image.Image]:
    """Return the figures that a notebook holds."""
    pictures = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        for output in cell.get("outputs", []):
            data = output.get("data", {}).get("image/png")
            if data:
                picture = Image.open(io.BytesIO(base64.b64decode(data)))
                pictures.append(picture.convert("RGB"))
    return pictures


def draw(name: str) -> Path:
    """Write the picture of one page beside it."""
    script = GALLERY / f"{name}.py"
    pictures = (
        figures_of_script(script)
        if script.exists()
        else figures_of_notebook(GALLERY / f"{name}.ipynb")
    )
    picture = pictures[SHOWN[name]]
    height = round(picture.height * WIDTH / picture.width)
    small = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
    target = GALLERY / f"{name}.png"
    small.quantize(COLOURS).save(target, optimize=True)
    return target


if __name__ == "__main__":
    mpl.use("Agg")
    for page in sys.argv[1:] or SHOWN:
        print(draw(page), flush=True)
