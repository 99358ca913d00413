"""What the pages of docs/ show of outputs, and whether a program still prints it."""

import re
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def printed(page: str) -> list[str]:
    """The lines of a page's output blocks; * stands for anything."""
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```output\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [" ".join(line.split()) for block in blocks for line in block.splitlines()]


def check_printed(page: str, said: str) -> None:
    """Every line that a page shows of outputs stands in them, however wide the terminal is."""
    whole = " ".join(said.split())
    for line in printed(page):
        pattern = re.escape(line).replace(r"\*", ".*?").replace(r"\?", ".").replace(r"\ ", r"\s*")
        assert re.search(pattern, whole), f"{page}: {line}\n{said}"
