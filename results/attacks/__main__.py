"""Attack the command line, and count what happens: python results/attacks --help"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path[0] = str(ROOT / "results")
sys.path[1:1] = [str(ROOT), str(ROOT / "tests" / "helpers")]

from attacks.attack import main

if __name__ == "__main__":
    main()
