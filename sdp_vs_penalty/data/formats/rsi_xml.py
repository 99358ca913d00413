"""What KUKA's RobotSensorInterface sends, saved as it comes: one XML element a cycle,
``<Rob><AIPos A1="..." .../><MACur A1="..." .../><IPOC>123</IPOC></Rob>``."""

import re
from pathlib import Path

from sdp_vs_penalty.data.formats.jsonl import log_of_samples
from sdp_vs_penalty.data.formats.text_file import iter_rows
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.errors import InputError

#: One cycle, a tag with its attributes, one attribute, and a tag with a number.
_CYCLE = re.compile(r"<Rob\b[^>]*>(.*?)</Rob>", re.DOTALL | re.IGNORECASE)
_TAG = re.compile(r"<(\w+)\s+([^<>]*?)/?>")
_ATTRIBUTE = re.compile(r"""(\w+)\s*=\s*["']([^"']*)["']""")
_NUMBER = re.compile(r"<(\w+)>\s*([-+.\deE]+)\s*</\1>")


def read_text(path: Path, refused: InputError) -> Log:
    """Read the columns, such as "AIPos.A1" and "IPOC", of cycles that RSI has sent; raise
    the error ``refused`` of another XML text."""
    text = "\n".join(row for _, rows in iter_rows(path) for row in rows)
    samples = [_fields_of(cycle[1]) for cycle in _CYCLE.finditer(text)]
    if len(samples) < 2:
        raise refused
    return log_of_samples(path, samples, range(1, len(samples) + 1), "cycle")


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
