"""A session as one file: a zip of JSON and CSV, without pickles, of bounded sizes."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_bytes

#: Members of an archive, and bytes that they may unpack to, all together.
MOST, LARGEST = 200, 2**30
_FORMAT = 1
_MEMBER = re.compile(r"session\.json|robot\.urdf|(runs|models)/\d{1,3}\.(csv|json)")
#: What of a session is kept as it is, and of each rung of its ladder.
KEPT = ("effects", "method", "seed", "frozen", "options", "found_for", "found_in", "curve_texts")
RUNG = ("label", "added", "frozen", "opened", "seconds")


def pack(state: Mapping[str, Any], members: Mapping[str, bytes], out: Path) -> None:
    """Write the zip: session.json with ``state``, and the members by their names."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("session.json", json.dumps({"format": _FORMAT, **state}, allow_nan=False))
        for name, content in members.items():
            archive.writestr(name, content)
    write_bytes(out, made.getvalue())


def unpack(path: Path, folder: Path) -> dict[str, Any]:
    """Write the members into a new folder; the state of session.json.

    Raises InputError for what is no such archive: foreign names, too many or too large members, JSON
    that lacks something.
    """
    wrong = InputError("not a session of this page", "choose a session.zip that was saved here", path)
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if len(entries) > MOST or sum(e.file_size for e in entries) > LARGEST:
                raise InputError(
                    f"unpacks to more than {LARGEST // 2**20} MB or {MOST} files", "save it anew", path
                )
            if not all(_MEMBER.fullmatch(e.filename) for e in entries):
                raise wrong
            for entry in entries:
                to = folder / entry.filename
                to.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(entry) as member:  # no more than was announced
                    to.write_bytes(member.read(entry.file_size))
        state = json.loads((folder / "session.json").read_text())
        if state["format"] != _FORMAT:
            raise wrong
        _require(state)
    except (zipfile.BadZipFile, OSError, ValueError, KeyError, TypeError, NotImplementedError) as error:
        raise wrong from error
    return dict(state)


def _require(state: Mapping[str, Any]) -> None:
    """KeyError, TypeError or ValueError unless every field is there and of its kind."""
    kinds = {"effects": list, "method": str, "seed": int, "frozen": bool, "options": dict}
    if not all(isinstance(state[name], kind) for name, kind in kinds.items()):
        raise TypeError("a field of another kind")
    if not all(isinstance(x, str) for x in (*state["effects"], *state["options"].values())):
        raise TypeError("an option of another kind")
    if state["findings"] is not None:
        Diagnosis.from_dict(state["findings"])
    for run in state["runs"]:
        if run["use"] not in ("train", "test", "split", "load") or not isinstance(run["name"], str):
            raise ValueError("a run of another kind")
    for rung in state["ladder"]:
        if set(rung) != set(RUNG) or not isinstance(rung["label"], str):
            raise ValueError("a model of another kind")
    source, gravity = state["robot"]["source"], state["robot"]["gravity"]
    if not re.fullmatch(r"[A-Za-z0-9_-]+|robot\.urdf", source):
        raise ValueError("a robot of another kind")
    if gravity is not None:
        _ = [float(g) for g in gravity]
