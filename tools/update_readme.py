"""Put the generated tables of results/ into README.md, between its marker lines.

    python tools/update_readme.py

The block holds results/headline.md word for word; tests/test_readme.py checks that it does.
"""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results: begin -->\n", "<!-- results: end -->\n"


def with_results(readme: str, results: str) -> str:
    """The README's text with the block between the markers replaced."""
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    if not (rest and after):
        raise ValueError("README.md has lost its marker lines")
    return f"{before}{BEGIN}\n{results.strip()}\n\n{END}{after}"


if __name__ == "__main__":
    readme = ROOT / "README.md"
    headline = (ROOT / "results" / "headline.md").read_text()
    readme.write_text(with_results(readme.read_text(), headline))
