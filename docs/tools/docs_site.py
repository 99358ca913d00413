"""MkDocs hook: the results that pages of docs/ refer to are pages of the site, too, and
so is every command's help."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[2]
_RESULT = re.compile(r"\]\((?:\.\./)+(results/[\w/]+\.(?:md|csv|svg))(#[\w-]+)?\)")


def on_files(files: Any, config: Any) -> Any:
    """Add every result that a page names."""
    pages = Path(config["docs_dir"]).glob("**/*.md")
    named = {
        link[1]
        for page in pages
        for link in _RESULT.finditer(page.read_text(encoding="utf-8"))
    }
    for name in sorted(named):
        text = (ROOT / name).read_text(encoding="utf-8")
        # What a result refers to is not there: its links become their text.
        if name.endswith(".md"):
            text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
        files.append(File.generated(config, name, content=text))
    files.append(File.generated(config, "options.md", content=options_page()))
    return files


def options_page() -> str:
    """Every command's options, as its own --help prints them."""
    from sdp_vs_penalty.cli.main import VERBS, import_verb
    from sdp_vs_penalty.cli.options import Parser

    lines = ["# Every option", ""]
    for purpose, verbs in VERBS.items():
        lines += [f"## {purpose}", ""]
        for name in verbs:
            text = Parser(name, import_verb(name)).format_help().rstrip()
            lines += [f"### {name}", "", "```text", text, "```", ""]
    return "\n".join(lines)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Point links to results at their copies in the site."""
    up = "../" * page.file.src_uri.count("/")
    return _RESULT.sub(rf"]({up}\1\2)", markdown)


_ROLE = re.compile(r":(?:class|func|attr|meth|mod|data):<code>(~?)([^<]*)</code>")


def on_page_content(html: str, **_: Any) -> str:
    """Show a role of a docstring as the name that it refers to."""
    return _ROLE.sub(
        lambda role: f"<code>{role[2].split('.')[-1] if role[1] else role[2]}</code>",
        html,
    )
