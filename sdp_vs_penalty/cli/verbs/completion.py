import argparse
from enum import StrEnum

from sdp_vs_penalty.cli import console

#: Shells whose completion can be written.
Shell = StrEnum("Shell", "bash zsh tcsh")


def verb(shell: Shell = Shell.bash) -> None:
    """Print the script that completes commands, options and file names in your shell.

    For bash: `eval "$(sdp-vs-penalty completion bash)"` in ~/.bashrc.
    Example: sdp-vs-penalty completion bash

    shell: Shell to print it for.
    """
    import shtab

    for line in shtab.complete(_whole_parser(), shell.value).expandtabs().splitlines():
        console.say(line)


def _whole_parser() -> argparse.ArgumentParser:
    """Return one argparse parser of the program with all its verbs."""
    import shtab

    from sdp_vs_penalty.cli.main import VERBS, import_verb
    from sdp_vs_penalty.cli.options import Parser

    whole = argparse.ArgumentParser("sdp-vs-penalty")
    verbs = whole.add_subparsers()
    for summaries in VERBS.values():
        for name, summary in summaries.items():
            parser = Parser(name, import_verb(name))
            for option in parser.options.values():
                if option.nargs != 0 and option.choices is None:
                    option.complete = shtab.FILE  # type: ignore[attr-defined]
            verbs.add_parser(name, parents=[parser], add_help=False, help=summary)
    return whole
