"""File systems with little room."""

import os
import subprocess
from pathlib import Path


def mount_small_disk(folder: Path, kibibytes: int) -> bool:
    """Put a file system of so many KiB in the place of a folder; whether it could be."""
    if os.getuid() != 0:
        return False
    options = ["-t", "tmpfs", "-o", f"size={kibibytes}k", "tmpfs", folder]
    done = subprocess.run(["mount", *options], capture_output=True, check=False)
    return done.returncode == 0


def unmount(folder: Path) -> None:
    """Take a file system away; it may still be in use."""
    subprocess.run(["umount", "-l", folder], capture_output=True, check=False)
