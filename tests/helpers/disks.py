"""File systems with little room."""

import os
import subprocess
from contextlib import contextmanager


def mount_small_disk(folder, kibibytes):
    """Put a file system of so many KiB in the place of a folder; whether it could be."""
    if os.getuid() != 0:
        return False
    options = ["-t", "tmpfs", "-o", f"size={kibibytes}k", "tmpfs", folder]
    done = subprocess.run(["mount", *options], capture_output=True, check=False)
    return done.returncode == 0


def unmount(folder):
    """Take a file system away; it may still be in use."""
    subprocess.run(["umount", "-l", folder], capture_output=True, check=False)


@contextmanager
def small_disk(folder, kibibytes):
    """While this runs, the folder has room for so many KiB, where root can mount a file
    system; yields whether it is so."""
    folder.mkdir(exist_ok=True)
    is_small = mount_small_disk(folder, kibibytes)
    try:
        yield is_small
    finally:
        if is_small:
            unmount(folder)
