"""HTML by jinja2: templates that escape everything and compute nothing."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from sdp_vs_penalty import formatting

#: Where a package's templates lie, beside the modules that fill them.
_FOLDERS = (Path(__file__).parent / "html",)


@cache
def environment(*folders: Path) -> Environment:
    """Return the jinja2 environment with the templates of these folders.

    Every value is escaped. A variable that a template misses is an error.
    """
    made = Environment(
        loader=FileSystemLoader([*folders, *_FOLDERS]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["code"] = mark_code
    made.filters["sentence"] = formatting.sentence
    return made


def render(template: str, *folders: Path, **context: Any) -> str:
    """Fill a template with variables, and return the HTML; ``folders`` are searched
    before this package's."""
    return environment(*folders).get_template(template).render(context)


def mark_code(sentence: object) -> Markup:
    """Escape a sentence for HTML; text between backticks becomes <code>.

    >>> str(mark_code("run `check` <b>"))
    'run <code>check</code> &lt;b&gt;'
    """
    escaped = str(escape(sentence))
    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", escaped))
