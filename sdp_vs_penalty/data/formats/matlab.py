"""MATLAB .mat files (versions 4 to 7) with variables t, q, tau (dq optional), or q1, q2, ..."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import Choice, check_size, from_columns
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, unreadable
from sdp_vs_penalty.files import writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".mat",)


def read(path: Path, choice: Choice) -> Measurements:
    """Variables of the file, or the fields of its one struct; other variables are ignored."""
    from scipy.io import loadmat, whosmat

    try:
        with path.open("rb") as file:
            start = file.read(128)
        if start.startswith(b"MATLAB 7.3") or start.startswith(b"\x89HDF"):
            raise InputError("a version 7.3 file (HDF5)", "save it with save(..., '-v7')", path)
        numbers = sum(int(np.prod(shape, dtype=float)) for _, shape, _ in whosmat(path))
        check_size(path, 8 * numbers, path.stat().st_size)
        _check_elements(path)
        content = loadmat(path, simplify_cells=True)
    except InputError:
        raise
    except OSError as error:
        raise unreadable(error, path) from error
    except Exception as error:  # the reader has no exception of its own
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"not a readable .mat file ({what})", "save it again, as version 7 or earlier", path
        ) from error
    named = {name: value for name, value in content.items() if not name.startswith("__")}
    structs = [value for value in named.values() if isinstance(value, Mapping)]
    if len(structs) == 1 and len(named) == 1:
        named = dict(structs[0])
    return from_columns(path, _numeric(named), choice.rename)


#: Type of a compressed element in a version 5 file, and what an element begins with: type, bytes.
_COMPRESSED, _TAG = 15, "II"
#: Bytes unpacked at a time.
_PIECE = 1 << 20


def _check_elements(path: Path) -> None:
    """What the compressed elements unpack to, counted piece by piece and not kept: the names and
    shapes of a file do not tell how much a struct holds."""
    with path.open("rb") as file:
        start = file.read(128)
        if start[126:128] not in (b"IM", b"MI"):
            return  # version 4: not compressed
        tag = struct.Struct(("<" if start[126:128] == b"IM" else ">") + _TAG)
        unpacked = packed = 0
        while len(head := file.read(tag.size)) == tag.size:
            kind, length = tag.unpack(head)
            if kind != _COMPRESSED:
                file.seek(length, io.SEEK_CUR)
                continue
            packed += length
            end, stream = file.tell() + length, zlib.decompressobj()
            while file.tell() < end and not stream.eof:
                rest = file.read(min(_PIECE, end - file.tell()))
                if not rest:
                    return  # cut off: the reader says so
                while rest:
                    unpacked += len(stream.decompress(rest, _PIECE))
                    check_size(path, unpacked, packed)
                    rest = stream.unconsumed_tail
            file.seek(end)


def _numeric(named: Mapping[str, Any]) -> dict[str, Array]:
    out = {}
    for name, value in named.items():
        array = np.asarray(value)
        if array.dtype.kind in "fiu" and array.ndim <= 2:
            out[str(name)] = np.atleast_1d(array.astype(float))
    return out


def write(measurements: Measurements, path: Path) -> None:
    from scipy.io import savemat

    m = measurements
    content = {"t": m.t[:, None], **m.groups}
    with writing(path) as file:
        savemat(file, content, do_compression=True)
