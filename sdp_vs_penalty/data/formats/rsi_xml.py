"""What KUKA's RobotSensorInterface sends, saved as it comes: one XML element a cycle,
``<Rob><AIPos A1="..." .../><MACur A1="..." .../><IPOC>123</IPOC></Rob>``."""

import re
from pathlib import Path

from sdp_vs_penalty.data.formats import jsonl
from sdp_vs_penalty.data.formats.columns import Choice, Header
from sdp_vs_penalty.data.formats.text_table import iter_rows
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError

#: One cycle, a tag with its attributes, one attribute, and a tag with a number.
_CYCLE = re.compile(r"<Rob\b[^>]*>(.*?)</Rob>", re.DOTALL | re.IGNORECASE)
_TAG = re.compile(r"<(\w+)\s+([^<>]*?)/?>")
_ATTRIBUTE = re.compile(r"""(\w+)\s*=\s*["']([^"']*)["']""")
_NUMBER = re.compile(r"<(\w+)>\s*([-+.\deE]+)\s*</\1>")


def read(path: Path, choice: Choice, refused: InputError) -> Measurements:
    """Read the run of cycles that RSI has sent.

    Parameters
    ----------
    choice : Choice
        The robot's joints, the fields chosen by ``--rename``, and the rate.
    refused : InputError
        The error of another XML text.

    Returns
    -------
    Measurements
        The run in SI units, one row a cycle. Fields are called "AIPos.A1" and "IPOC".

    Raises
    ------
    InputError
        Another XML text, or a channel that is missing.
    """
    text = "\n".join(row for _, rows in iter_rows(path) for row in rows)
    samples = [_fields_of(cycle[1]) for cycle in _CYCLE.finditer(text)]
    if len(samples) < 2:
        raise refused
    numbers = range(1, len(samples) + 1)
    columns, joints = jsonl.columns_and_joints_of(path, samples, numbers, "cycle")
    table = jsonl.cell_table(columns, joints)
    return Header.of(path, list(table.kinds), choice, table=table).read(columns)


def _fields_of(cycle: str) -> dict[str, float]:
    """Return the numbers of one cycle by their names."""
    fields = {
        f"{tag}.{name}": value
        for tag, attributes in _TAG.findall(cycle)
        for name, value in _ATTRIBUTE.findall(attributes)
    }
    fields |= dict(_NUMBER.findall(cycle))
    numbers = dict[str, float]()
    for name, text in fields.items():
        try:
            numbers[name] = float(text)
        except ValueError:
            continue  # the name of a program, say
    return numbers
