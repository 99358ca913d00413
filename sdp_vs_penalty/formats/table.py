"""NPZ: NumPy's own archive of arrays."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.formats import columns_of
from sdp_vs_penalty.measurements import Measurements


def write_npz(measurements: Measurements, path: Path) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **columns_of(measurements))  # type: ignore[arg-type]
    write_bytes(path, buffer.getvalue())
