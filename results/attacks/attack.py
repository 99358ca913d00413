"""Attack the command line, and count what happens.

    python results/attacks --number 400 --seed 1
    python results/attacks --number 400 --seed 2 --kinds surroundings

Each attack is a command in a process of its own. It fails where the process ends by a
signal, takes more than 30 s, prints a traceback, an internal error, a warning of NumPy,
a raw control character or a command that a shell takes for something else, changes what
was there, leaves a process or a partial file, or runs what a name says. Kinds of files are bytes and
structure of what is read; kinds of surroundings are what a command meets while it runs.
"""

import argparse
import os
import re
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import killing
import numpy as np
import pandas
from hostile_names import raw_controls

from attacks.sound import write_sound_files
from attacks.whole import broken_outputs
from sdp_vs_penalty.files import write_text

Rng = np.random.Generator
#: Seconds that an attack may take.
PATIENCE = 30.0
BAD = re.compile(rb"Traceback|internal error|RuntimeWarning|DeprecationWarning")


def nothing() -> None:
    """What is done to the surroundings of most attacks."""


@dataclass(frozen=True)
class Attack:
    """A command against which something was prepared.

    words : of the command; surround : changes the process before the command begins;
    clean_up : ends what was prepared; kill : seconds after which it gets a signal, and
    the signal; rival : the words of a command that runs at the same time; again :
    whether the same command must succeed, undisturbed, afterwards; encoding : of its
    terminal.
    """

    words: Sequence[str]
    surround: Callable[[], object] = nothing
    clean_up: Callable[[], object] = nothing
    kill: tuple[float, signal.Signals] | None = None
    rival: Sequence[str] = ()
    again: bool = False
    encoding: str = "utf-8"


#: How an attack is prepared in a folder of sound files.
Kind = Callable[[Path, Rng], Attack]


def start(attack: Attack, words: Sequence[str], folder: Path, printed: Path) -> int:
    """Start the command in a process of its own; its number."""
    code = 130
    child = os.fork()
    if child:
        return child
    try:
        code = run_here(attack, words, folder, printed)
    finally:
        os._exit(code)


def run_here(attack: Attack, words: Sequence[str], folder: Path, printed: Path) -> int:
    """The exit code of the command, run in this process, which is to end then."""
    from sdp_vs_penalty.cli.main import main as command_line

    code = 70
    try:
        os.setsid()
        os.chdir(folder)
        handle = os.open(printed, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        (folder / "tmp").mkdir(exist_ok=True)
        os.environ["TMPDIR"] = str(folder / "tmp")
        attack.surround()
        for handle, name in ((1, "stdout"), (2, "stderr")):
            setattr(sys, name, open_stream(handle, attack.encoding))
        command_line(list(words))
    except SystemExit as end:
        code = int(end.code or 0)
    except KeyboardInterrupt:
        code = 130
    except BaseException as error:
        os.write(2, f"Traceback: {error!r}".encode())
    with suppress(OSError, ValueError, AttributeError, KeyboardInterrupt):
        sys.stdout.flush()
        sys.stderr.flush()
    return code


def open_stream(handle: int, encoding: str) -> TextIO | None:
    """A stream as the interpreter opens it; None where it is closed."""
    try:
        return open(handle, "w", encoding=encoding, closefd=False)
    except OSError:
        return None


def outcome(attack: Attack, folder: Path) -> tuple[str, bytes]:
    """What becomes of an attack, "ok" or what is wrong, and what was printed."""
    before = contents(folder)
    sheets = [folder.parent / name for name in ("printed", "printed by the rival")]
    known = killing.descendants()
    processes = [start(attack, attack.words, folder, sheets[0])]
    if attack.rival:
        processes.append(start(attack, attack.rival, folder, sheets[1]))
    if attack.kill is not None:
        seconds, number = attack.kill
        time.sleep(seconds)
        with suppress(ProcessLookupError):
            os.kill(processes[0], number)
    printed = b""
    for process, sheet in zip(processes, sheets, strict=False):
        try:
            code = killing.wait_for(process, PATIENCE)
        except TimeoutError:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            return "hang", sheet.read_bytes()
        printed = sheet.read_bytes()
        wrong = wrong_end(code, attack) or wrong_words(printed, folder)
        if wrong:
            return wrong, printed
    if living := killing.survivors(known):
        return f"left {living}", printed
    if lost := before.items() - contents(folder).items():
        return f"lost {sorted(name for name, _ in lost)}", printed
    new = [path for path in folder.iterdir() if path.name not in before]
    if broken := broken_outputs(new):
        return f"left {broken}", printed
    temporary = [path.name for path in (folder / "tmp").glob("*")]
    if temporary and not (attack.kill and attack.kill[1] == signal.SIGKILL):
        return f"left {temporary}", printed
    if attack.again:
        return outcome(Attack(attack.words), folder)
    return "ok", printed


def contents(folder: Path) -> dict[str, bytes]:
    """What each file of a folder holds; nothing for links, pipes and folders."""
    return {
        path.name: path.read_bytes() if stat.S_ISREG(path.lstat().st_mode) else b""
        for path in folder.iterdir()
    }


def wrong_end(code: int, attack: Attack) -> str:
    """What is wrong with an exit code, if anything."""
    if attack.kill is not None and code in (130, -attack.kill[1], 128 + attack.kill[1]):
        return ""
    if code < 0:
        return f"signal {-code}"
    return "" if code in (0, 1, 2) else f"exit code {code}"


def wrong_words(printed: bytes, folder: Path) -> str:
    """What is wrong with what was printed, if anything."""
    if found := BAD.search(printed):
        return found[0].decode()
    if controls := raw_controls(printed):
        return f"raw {controls[0]!r}"
    for line in printed.decode("utf-8", "replace").splitlines():
        if line.startswith("Next: ") and (
            wrong := pasted(line[len("Next: ") :], folder)
        ):
            return wrong
    return ""


def pasted(command: str, folder: Path) -> str:
    """What is wrong with a printed command when a shell reads it, if anything."""
    if command.startswith("sdp-vs-penalty "):
        script = f"sdp-vs-penalty() {{ :; }}; {command}"
        done = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True)
        if done.returncode or done.stderr:
            return f"unquoted {shlex.quote(command)}"
    return "ran PWNED" if (folder / "PWNED").exists() else ""


def attack_all(
    kinds: Mapping[str, Kind], number: int, seed: int, out: Path | None = None
) -> int:
    """Attack ``number`` times, kind after kind, and return how many attacks failed.

    Prints each failure and a line for each kind. ``out`` is the folder that gets
    attacks.csv, with the number of attacks and failures of each kind.
    """
    names = list(kinds)
    n_failed = Counter[str]()
    n_tried = Counter[str]()
    with tempfile.TemporaryDirectory() as home, killing.adopting_orphans():
        base = Path(home) / "sound"
        base.mkdir()
        write_sound_files(base)
        for k in range(number):
            name = names[k % len(names)]
            folder = Path(home) / "attack"
            shutil.copytree(base, folder)
            rng = np.random.default_rng([seed, k])
            begin = time.monotonic()
            attack = kinds[name](folder, rng)
            try:
                result, printed = outcome(attack, folder)
            finally:
                attack.clean_up()
            n_tried[name] += 1
            if result != "ok":
                n_failed[name] += 1
                text = printed.decode("utf-8", "backslashreplace")
                place = text.find("Traceback")
                text = text[-400:] if place < 0 else text[place : place + 900]
                print(f"{k} {name}: {result}: {attack.words}: {text!r}", flush=True)
            if time.monotonic() - begin > 0.5 * PATIENCE:
                print(f"{k} {name}: {time.monotonic() - begin:.0f} s", flush=True)
            shutil.rmtree(folder)
    for name in names:
        print(f"{name:26} {n_tried[name]:4} tried, {n_failed[name]} failed")
    print(f"{n_tried.total()} attacks, {n_failed.total()} failed")
    if out is not None:
        rows = [(name, n_tried[name], n_failed[name]) for name in names]
        rows.append(("all", n_tried.total(), n_failed.total()))
        table = pandas.DataFrame(rows, columns=["kind", "tried", "failed"])
        write_text(out / "attacks.csv", table.to_csv(index=False))
    return n_failed.total()


def main() -> None:
    """Attack as the command line says; exit code 1 where an attack fails."""
    from attacks import files, surroundings, typed

    tables = {
        "files": files.KINDS,
        "surroundings": surroundings.KINDS,
        "typed": typed.KINDS,
    }
    parser = argparse.ArgumentParser(description="Attack the command line.")
    parser.add_argument("--number", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", choices=[*tables, "all"], default="all")
    parser.add_argument("--only", help="a part of the names of kinds", default="")
    parser.add_argument("--out", type=Path, help="folder for attacks.csv")
    options = parser.parse_args()
    kinds: dict[str, Kind] = {}
    for name, table in tables.items():
        if options.kinds in (name, "all"):
            kinds.update({k: kind for k, kind in table.items() if options.only in k})
    n_failed = attack_all(kinds, options.number, options.seed, options.out)
    sys.exit(min(n_failed, 1))
