"""Locales with another decimal point, other letters and other bytes."""

import locale
import os
import shutil
import subprocess

#: By the character set of each; Turkish has an i without a dot. None is of UTF-8, which
#: takes five times as long to make, and is the character set of tests anyhow.
LOCALES = {"de_DE": "ISO-8859-15", "tr_TR": "ISO-8859-9", "fr_FR": "ISO-8859-1"}


def make_locales(folder):
    """Make these locales in a folder; the names of those that the system can make."""
    if shutil.which("localedef") is None:
        return []
    names = []
    for name, charset in LOCALES.items():
        place = folder / f"{name}.{charset}"
        options = ["-c", "-i", name, "-f", charset, place]
        subprocess.run(["localedef", *options], capture_output=True, check=False)
        if place.exists():
            names.append(place.name)
    return names


def set_locale(name, folder):
    """Set a locale of the folder for this process and its libraries in C; whether it
    could be."""
    os.environ["LOCPATH"] = str(folder)
    os.environ["LC_ALL"] = name
    try:
        locale.setlocale(locale.LC_ALL, "")
    except locale.Error:
        return False
    return True
