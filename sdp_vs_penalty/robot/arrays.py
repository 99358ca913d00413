"""What all numbers of this package come in: arrays of doubles, whose shapes the docstrings say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
