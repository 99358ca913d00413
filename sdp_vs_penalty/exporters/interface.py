"""The names that a module of this folder has if it is a format of export."""

from typing import Protocol

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Options

#: A file's bytes, and the effects that have no place in it, as they are written.
Written = tuple[bytes, tuple[str, ...]]


class ExportFormat(Protocol):
    """A format of export: a module with these names, found by its ``ENDING``.

    Three more names are optional:

    - ``HOLDS``, in formats that hold a model of the torque: their fields, a collection
      of SimulatorField.
    - ``EDITS = "URDF"`` or "MJCF", in formats that can edit the user's own file of that
      kind, ``options.own_file``.
    - ``BODIES = False``, in formats that hold neither links nor a payload.
    """

    #: How the names of such files end, ".sdf"; the longest that fits a name decides.
    ENDING: str
    #: What the page calls the file.
    FILE: str
    #: What the format is for, in a few words.
    ABOUT: str

    def write(self, estimate: Estimate, options: Options) -> Written:
        """Make a file.

        Parameters
        ----------
        estimate : Estimate
            The model to write, with its problem.
        options : Options
            The user's own file to edit, whether implausible links are taken (``force``), and the
            flange of a payload [m].

        Returns
        -------
        content : bytes
            All bytes of the file.
        left_out : tuple of str
            The effects that have no place in it, as they are written.

        Raises
        ------
        InputError
            For a model that the format cannot hold at all, such as one with an
            impossible link.
        """
        ...
