"""Formats of an exported model, one small file each; a file with ENDING and write() is
its registration.

ENDING : how the names of such files end, ".sdf"; the longest that fits a name decides.
FILE : what the page calls the file; ABOUT : what it is for, in a few words.
write(estimate, options) : the bytes of the file, and the effects that the format has no
place for. HOLDS (of a file that holds a model) : names of the effects that have one.
EDITS (where it is so) : the user's own file can be edited instead,
``options.urdf``.
"""
