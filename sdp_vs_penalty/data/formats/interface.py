"""What a module of this folder offers to be a format of measurements."""

from pathlib import Path
from typing import Protocol

from sdp_vs_penalty.data.formats.columns import Choice
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array


class MeasurementFormat(Protocol):
    """A format of measurements: a module with these names, found by its ``SUFFIXES``.

    Three more names are optional. ``FOLDER`` is a pattern of files: a folder that holds
    one is such a run. ``SAMPLE`` is what messages call a sample, "row" or "line".
    ``HAS_TOPICS = True`` is of files that hold several topics.
    """

    #: Suffixes of such files, ".csv"; empty for a format of folders.
    SUFFIXES: tuple[str, ...]

    def read(self, path: Path, choice: Choice) -> Measurements:
        """Read one run as it is in the file: the clock and the numbers are checked later.

        Parameters
        ----------
        choice : Choice
            The robot's joints, the columns chosen by ``--rename``, the rate, the topic.

        Returns
        -------
        Measurements
            The run in SI units, one row a sample.

        Raises
        ------
        InputError
            A file that cannot be read, or a channel that is missing.
        """
        ...


class TableFormat(MeasurementFormat, Protocol):
    """A format whose files hold columns by name: they can be recognised and joined."""

    def inspect(self, path: Path) -> CellTable:
        """Describe the columns by their first values, for the recogniser of columns.

        Returns
        -------
        CellTable
            By the column's name its kind ("number", "list", ...) and its first values.
        """
        ...

    def read_columns(self, path: Path) -> dict[str, Array]:
        """Read the columns that are numbers.

        Returns
        -------
        dict of str to array
            (N,) numbers, or (N, n) where a column is a block or holds lists, by name;
            "#1", "#2" ... where columns have no names.

        Raises
        ------
        InputError
            A file that cannot be read.
        """
        ...


class WritableFormat(MeasurementFormat, Protocol):
    """A format in which runs can be written."""

    def write(self, measurements: Measurements, path: Path) -> None:
        """Write one run. The file appears when it is complete.

        Parameters
        ----------
        path : Path
            Path of the file to write.
        """
        ...
