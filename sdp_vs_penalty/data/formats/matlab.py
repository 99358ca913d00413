"""MATLAB .mat files (versions 4 to 7; 7.3 with h5py) with variables t, q, tau (dq optional), or q1,
q2, ...; and the text that Octave's ``save`` writes of such variables."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.formats.limits import joint_names_in, parse_apart, texts_apart
from sdp_vs_penalty.data.formats.npz import columns_of_array
from sdp_vs_penalty.data.formats.text_file import iter_rows
from sdp_vs_penalty.data.log import Log, log_of_arrays
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import writing
from sdp_vs_penalty.robot.arrays import Array, Arrays

SUFFIXES: tuple[str, ...] = (".mat",)
#: Fields of a signal's label and values: of Simulink, and of dSPACE.
_LABELS_AND_VALUES = ("label", "values"), ("Name", "Data")


def read(path: Path) -> Log:
    """Read the numeric variables of a .mat file: (N,) numbers or (N, n) blocks.

    Fields of structs are called "log.q". A file with one matrix, as Simulink writes it,
    gives its columns "#1", "#2" .... A process of its own parses the file: one wrong
    byte can end it. One of version 7.3 is HDF5; MATLAB writes a matrix (N, n) as (n, N)
    there, which whoever makes a run of it turns.
    """
    with path.open("rb") as file:
        start = file.read(128)
    if start.startswith((b"MATLAB 7.3", b"\x89HDF")):
        from sdp_vs_penalty.data.formats import hdf5

        try:
            return hdf5.read(path)
        except InputError as error:
            what = f"a version 7.3 file ({error.what})"
            remedy = f"save it with save(..., '-v7'), or {error.remedy}"
            raise InputError(what, remedy, path) from error
    kind = ".mat file", "save it again, as version 7 or earlier"
    sent = parse_apart(numeric_variables, path, "scipy.io", *kind)
    variables, texts = texts_apart(sent)
    return _log_of_variables(path, variables, texts)


def _log_of_variables(
    path: Path,
    variables: Arrays,
    texts: Mapping[str, Sequence[Sequence[str]]] | None = None,
) -> Log:
    """Make a log of variables; a single matrix gives its columns."""
    arrays = {name: np.atleast_1d(block) for name, block in variables.items()}
    if len(arrays) == 1:
        (block,) = arrays.values()
        if block.ndim > 1 and min(block.shape) > 1:
            arrays = columns_of_array(path, block)
    return log_of_arrays(path, arrays, texts)


def read_text(path: Path, _refused: InputError) -> Log:
    """Read the matrices of the text that Octave's ``save -text`` writes.

    Above the rows of each stand lines of comment, "# name: q", "# type: matrix" and its
    size. A matrix of one column becomes a column (N,). ``_refused`` is the error of the
    reader of tables, which some formats of text raise again.
    """
    lines = chain.from_iterable(piece for _, piece in iter_rows(path))
    _head, *variables = "\n".join(lines).split("# name: ")
    matrices = dict[str, Array]()
    for variable in variables:
        name, *lines_below = variable.splitlines()
        is_row = [line.strip() and not line.startswith("#") for line in lines_below]
        rows = [line.split() for line in compress(lines_below, is_row)]
        if not rows:
            continue
        try:
            matrix = np.array(rows, float)
        except ValueError as error:
            what = f"what stands below the name {name} is no matrix of numbers"
            remedy = "save matrices of numbers alone, with save('run.mat', '-v7', ...)"
            raise InputError(what, remedy, path) from error
        has_one_column = matrix.shape[1] == 1
        matrices[name.strip()] = matrix[:, 0] if has_one_column else matrix
    return _log_of_variables(path, matrices)


def numeric_variables(path: str) -> Iterator[dict[str, Array]]:
    """Parse the numeric variables of a .mat file, one at a time: a name and its numbers
    (N, n). To be run in a process of its own: one wrong byte in the file can end it."""
    from scipy.io import loadmat

    content = loadmat(path, simplify_cells=True)
    named = {
        name: value for name, value in content.items() if not name.startswith("__")
    }
    structs = [value for value in named.values() if isinstance(value, Mapping)]
    if len(structs) == 1 and len(named) == 1:
        named = dict(structs[0])
    for name, value in named.items():
        yield from joint_names_in(name, value)
    has_numbers = False
    for name, block in _leaves(named):
        has_numbers = True
        yield {name: block}
    opaque = [x for value in named.values() for x in _objects_in(value)]
    if opaque and not has_numbers:
        raise _only_matlab_reads(path, *opaque[0])


def _objects_in(value: object) -> list[tuple[str, str]]:
    """List name and class of each variable that is an object of MATLAB's own, such as
    ("log", "table"): a file holds no numbers of it that others can read."""
    from scipy.io.matlab import MatlabOpaque

    if not isinstance(value, MatlabOpaque):
        return []
    return [
        (
            bytes(x["s0"]).decode(errors="replace"),
            bytes(x["s2"]).decode(errors="replace"),
        )
        for x in np.ravel(value)
    ]


def _only_matlab_reads(path: str, name: str, kind: str) -> InputError:
    """Return the error of a file that holds nothing but an object of a MATLAB class."""
    remedy = "save its numbers as a matrix"
    if kind in ("table", "timetable"):
        inner = name if kind == "table" else f"timetable2table({name})"
        remedy = (
            f"write it in MATLAB with writetable({inner}, 'run.csv'), or save"
            f" s = table2struct({inner}, 'ToScalar', true) with save('run.mat', 's')"
        )
    return InputError(
        f"{name} is a MATLAB {kind}, which only MATLAB reads", remedy, path
    )


def _leaves(
    values: Mapping[str, object], prefix: str = ""
) -> Iterator[tuple[str, Array]]:
    """Iterate over the numeric variables of nested structs, named like
    "log.joint.position"."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{name}.")
            continue
        structs = _structs_of(value)
        if structs:
            yield from _leaves(_by_label_or_number(key, structs), prefix)
            continue
        block = _stacked_cells(np.asarray(value))
        if block.dtype.kind in "fiu" and block.ndim <= 2:
            yield name, block.astype(float)


def _stacked_cells(block: NDArray[Any]) -> NDArray[Any]:
    """Return cells of N equally long numeric vectors (n,) as one block (N, n); anything
    else as it is."""
    if block.dtype != object or block.ndim != 1 or not len(block):
        return block
    cells = [np.asarray(cell) for cell in block]
    are_numbers = all(cell.dtype.kind in "fiu" and cell.ndim < 2 for cell in cells)
    has_one_shape = len({cell.shape for cell in cells}) == 1
    return np.array(cells) if are_numbers and has_one_shape else block


def _structs_of(value: object) -> list[Mapping[str, object]]:
    """Return the structs of an array of structs; empty for any other variable."""
    is_array = isinstance(value, list) or (
        isinstance(value, np.ndarray) and value.dtype == object
    )
    items = list(np.ravel(np.asarray(value, object))) if is_array else []
    structs = [item for item in items if isinstance(item, Mapping)]
    return structs if len(structs) == len(items) else []


def _by_label_or_number(
    key: str, structs: Sequence[Mapping[str, object]]
) -> dict[str, object]:
    """Name the structs of an array: "joint1", "joint2" ...

    Signals of Simulink and dSPACE have their values and a label in each struct: they are
    called by the labels, where these differ.
    """
    for label, values in _LABELS_AND_VALUES:
        labels = [str(struct.get(label, "")).strip() for struct in structs]
        if all(labels) and len({*labels}) == len(labels):
            units = [str(struct.get("Unit", "")).strip() for struct in structs]
            names = [
                f"{x} [{y}]" if y else x for x, y in zip(labels, units, strict=True)
            ]
            blocks = [struct.get(values) for struct in structs]
            return dict(zip(names, blocks, strict=True))
    return {f"{key}{k}": struct for k, struct in enumerate(structs, start=1)}


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as a .mat file with the variables t (N, 1), q, dq and tau (N, n)."""
    from scipy.io import savemat

    m = measurements
    with writing(path) as file:
        savemat(file, {"t": m.t[:, None], **m.groups}, do_compression=True)
