"""Parsers that do what a broken file can make one do."""

import os
import socket
import subprocess
import time
import warnings
from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty import InputError
from sdp_vs_penalty.errors import Remark


def echo(path: str, numbers: list[float]) -> Iterator[dict[str, np.ndarray]]:
    for number in numbers:
        yield {"number": np.full((2, 3), number)}


def crash(path: str) -> Iterator[dict[str, np.ndarray]]:
    yield {"number": np.zeros(1)}
    os.abort()


def wait(path: str) -> Iterator[dict[str, np.ndarray]]:
    yield {"number": np.zeros(1)}
    time.sleep(100.0)


def work(path: str) -> Iterator[dict[str, np.ndarray]]:
    while True:
        pass
    yield {}


def fill(path: str) -> Iterator[dict[str, np.ndarray]]:
    yield {"number": np.ones(2**30)}


def refuse(path: str) -> Iterator[dict[str, np.ndarray]]:
    warnings.warn("row 3 is odd", Remark, stacklevel=2)
    raise InputError("row 4 is wrong", "delete it", path)
    yield {}


def connect(path: str) -> Iterator[dict[str, np.ndarray]]:
    socket.socket()
    yield {}


def start(path: str) -> Iterator[dict[str, np.ndarray]]:
    subprocess.run(["true"], check=True)
    yield {}
