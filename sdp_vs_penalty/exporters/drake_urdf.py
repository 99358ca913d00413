"""A URDF for Drake: its own tags carry the rotors' inertias."""

from functools import partial

from sdp_vs_penalty.exporters import urdf

ENDING = ".drake.urdf"
FILE = "robot.drake.urdf"
ABOUT = "for Drake, with rotor inertias"
EDITS = urdf.EDITS
HOLDS = urdf.HOLDS | {"armature"}
write = partial(urdf.write, drake=True)
