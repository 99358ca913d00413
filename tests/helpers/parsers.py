"""Parsers that do what a broken file can make one do."""

import os
import socket
import subprocess
import time
import warnings

import numpy as np

from sdp_vs_penalty import InputError
from sdp_vs_penalty.errors import Remark


def echo(path, numbers):
    for number in numbers:
        yield {"number": np.full((2, 3), number)}


def crash(path):
    yield {"number": np.zeros(1)}
    os.abort()


def wait(path):
    yield {"number": np.zeros(1)}
    time.sleep(100.0)


def work(path):
    while True:
        pass
    yield {}


def fill(path):
    yield {"number": np.ones(2**30)}


def refuse(path):
    warnings.warn("row 3 is odd", Remark, stacklevel=2)
    raise InputError("row 4 is wrong", "delete it", path)
    yield {}


def connect(path):
    socket.socket()
    yield {}


def start(path):
    subprocess.run(["true"], check=True)
    yield {}
