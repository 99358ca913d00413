"""Every corruption on every arm: python results/corruptions --help"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[0] = str(Path(__file__).parents[1])  # for this process and its workers

from corruptions.bench import main

if __name__ == "__main__":
    main()
