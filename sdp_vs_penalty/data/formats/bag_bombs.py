"""ROS bags that would fill the memory: what is compressed is unpacked in pieces, counted, not kept."""

from __future__ import annotations

import bz2
import importlib
import io
import sqlite3
import struct
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.formats.columns import check_size
from sdp_vs_penalty.errors import InputError

#: Bytes unpacked at a time.
_PIECE = 1 << 20
#: Opcode of a chunk in a ROS 1 bag, and of an MCAP chunk with the start of its record: times, size.
_CHUNK, _MCAP_CHUNK, _MCAP_START = 5, 6, "<QQQ"
_MAGIC = b"#ROSBAG V2.0\n"
#: No record's header is longer.
_LONGEST_HEADER = 1 << 20


def check_bag(path: Path) -> None:
    """Raises InputError before the library unpacks a file that is a bomb."""
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.suffix == ".mcap":
            _mcap(file)
        elif file.suffix == ".bag":
            _ros1(file)
        elif file.suffix == ".db3":
            _messages(file)
        elif file.suffix == ".zstd":
            with file.open("rb") as stream:
                total = 0
                for piece in _zstd(stream):
                    total += piece
                    check_size(file, total, file.stat().st_size)


def _mcap(file: Path) -> None:
    """Every chunk's size, by its own header."""
    with file.open("rb") as stream:
        stream.seek(8)
        while len(head := stream.read(9)) == 9:
            kind, length = struct.unpack("<BQ", head)
            start = stream.tell()
            if kind == _MCAP_CHUNK:
                *_, unpacked = struct.unpack(_MCAP_START, stream.read(24))
                check_size(file, unpacked, length)
            stream.seek(start + length)


def _ros1(file: Path) -> None:
    """Every chunk, unpacked: the size in its header is what the file's maker says."""
    packed = unpacked = 0
    with file.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            return  # the reader says so
        while len(head := stream.read(4)) == 4:
            (length,) = struct.unpack("<I", head)
            if length > _LONGEST_HEADER:
                raise InputError(
                    "not a readable ROS bag (a header of a record is too long)", "record it again", file
                )
            fields = dict(_fields(stream.read(length)))
            size = stream.read(4)
            if len(size) < 4:
                return
            (length,) = struct.unpack("<I", size)
            end = stream.tell() + length
            if fields.get(b"op") == bytes([_CHUNK]):
                packed += length
                for piece in _chunk(stream, length, fields.get(b"compression", b"none")):
                    unpacked += piece
                    check_size(file, unpacked, packed)
            stream.seek(end)


def _fields(header: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 4 <= len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        yield name, value
        at += 4 + size


def _chunk(stream: io.BufferedReader, length: int, compression: bytes) -> Iterator[int]:
    """Sizes of the pieces that a chunk of a ROS 1 bag unpacks to."""
    unpack: Any = bz2.BZ2Decompressor() if compression == b"bz2" else None
    if compression == b"lz4":
        unpack = importlib.import_module("lz4.frame").LZ4FrameDecompressor()
    left = length
    if unpack is None:
        yield length
        return
    while left > 0 and not unpack.eof:
        packed = stream.read(min(_PIECE, left))
        if not packed:
            return
        left -= len(packed)
        yield len(unpack.decompress(packed, _PIECE))
        while not unpack.needs_input and not unpack.eof:
            yield len(unpack.decompress(b"", _PIECE))


def _zstd(stream: Any) -> Iterator[int]:
    """Where the bag library has it from: Python's own from 3.14 on."""
    home = "compression" if sys.version_info >= (3, 14) else "backports"
    with importlib.import_module(f"{home}.zstd").open(stream, "rb") as reader:
        while piece := reader.read(_PIECE):
            yield len(piece)


def _messages(file: Path) -> None:
    """Messages that are compressed one by one, as the bag's metadata says."""
    metadata = file.parent / "metadata.yaml"
    if not metadata.is_file() or "zstd" not in metadata.read_text(errors="replace"):
        return
    total = 0
    with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as data:
        for (message,) in data.execute("SELECT data FROM messages"):
            for piece in _zstd(io.BytesIO(message)):
                total += piece
                check_size(file, total, file.stat().st_size)
