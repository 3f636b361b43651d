"""The vectors of numbers in a MATLAB file (.mat), read with scipy in a process of its own.

On some broken files scipy's reader does not raise: the whole process ends with a segmentation fault. A program that
keeps a heater must not end that way.
"""

from __future__ import annotations

import io
import math
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.records.column_names import interpret_name
from rig.records.table import Table, table_from_arrays

MOST_COLUMNS = 1000  # of a matrix: more are a picture
MOST_NUMBERS = 250_000_000  # in one array: 2 GB, and zeros of that size are compressed to 2 MB
LONGEST = 400  # characters of a text: each row takes as much memory as the longest
DEEPEST = 3  # structs inside each other
NUMBERS = "biuf"  # numpy's kinds of real numbers
# by class: what to type in MATLAB
MATLAB_COMMANDS = {
    "table": "writetable({name}, '{stem}.csv')",
    "timetable": "writetimetable({name}, '{stem}.csv')",
    "datetime": "time_s = seconds({name} - {name}(1)); save('{stem}.mat', 'time_s', '-append')",
    "duration": "time_s = seconds({name}); save('{stem}.mat', 'time_s', '-append')",
}
ANY_COMMAND = "s = struct({name}); save('{stem}.mat', '-struct', 's', '-v7')"
TIMES = ("datetime", "duration")
BROKEN = "cannot be read as .mat: its sizes and kinds do not fit its bytes"
CHILD = "import sys; sys.path[:] = {paths!r}; from rig.records.matlab_table import send; send(sys.argv[1], {most})"


def matlab_table(path: Path) -> Table:
    """Return the vectors of one length in a .mat file, in structs and arrays of structs too. Raises Faults."""
    vectors, objects = read_vectors(path)
    meanings = {interpret_name(name).ours for name, _ in vectors}
    for name, kind in objects:
        needed = {"time_s" if kind in TIMES else "temperature_degC"}
        if not needed <= meanings or not meanings & {"temperature_degC", "current_A"}:
            typed = MATLAB_COMMANDS.get(kind, ANY_COMMAND).format(name=name, stem=path.stem)
            raise fault(path, name, f"a MATLAB {kind}, which only MATLAB reads; expected, typed there: {typed}")
    lengths = [values.size for _, values in vectors if values.size >= 2 and values.dtype.kind != "U"]
    if not lengths:
        text = "in a struct or beside each other, or an array of structs with a number in each field"
        raise fault(path, "", f"no vectors of numbers; expected one for each column, {text}")
    lengths += [values.size for name, values in vectors if interpret_name(name).ours is not None]  # each counts twice
    rows = max(set(lengths) - {0, 1}, key=lambda n: (lengths.count(n), n))
    chosen = [(name, values) for name, values in vectors if values.size == rows]
    names = [name for name, _ in chosen]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise Faults([f"{path}: {name!r} appears in more than one struct; expected each name once" for name in twice])
    table = table_from_arrays(dict(chosen), str(path))
    if objects:
        table.notes.append(f"MATLAB objects left out: {', '.join(name for name, _ in objects)}")
    if left := sorted({name for name, values in vectors if values.size not in (1, rows)}):
        table.notes.append(f"left out, of another length: {', '.join(left[:8])}")
    return table


def read_vectors(path: Path) -> tuple[list[tuple[str, Array]], list[tuple[str, str]]]:
    """Return names and vectors, and names and classes of MATLAB's objects, which scipy cannot read.

    A matrix gives a vector for each of its columns, an array of structs one for each field: of text if there is text,
    or if a field has no or several numbers. Raises Faults.
    """
    if not path.is_file():
        raise fault(path, "", "no such file")
    command = [sys.executable, "-c", CHILD.format(paths=sys.path, most=MOST_NUMBERS), str(path)]
    child = subprocess.run(command, capture_output=True, check=False)
    if child.returncode == 2:
        raise Faults(child.stderr.decode(errors="replace").strip().splitlines()[-1:])
    if child.returncode != 0:
        raise fault(path, "", BROKEN)
    with np.load(io.BytesIO(child.stdout), allow_pickle=False) as content:
        vectors = [(str(name), content[f"vector{k}"]) for k, name in enumerate(content["names"])]
        return vectors, [(str(name), str(kind)) for name, kind in content["objects"]]


def send(path: str, most: int) -> None:
    """Write the vectors as .npz to stdout, in the process of its own; or a line to stderr, and exit with status 2."""
    try:
        content = _load(Path(path), most)
        found, objects = list(_vectors(content)), _objects(content, Path(path))
    except Faults as faults:
        print(str(faults), file=sys.stderr)
        sys.exit(2)
    vectors = {f"vector{k}": values for k, (_, values) in enumerate(found)}
    kinds = np.array(objects, dtype=str).reshape(-1, 2)
    out = io.BytesIO()
    np.savez(out, names=np.array([name for name, _ in found], dtype=str), objects=kinds, **vectors)
    sys.stdout.buffer.write(out.getvalue())


def _load(path: Path, most: int) -> Any:
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadWarning

    try:
        try:
            largest = max((math.prod(shape) for _, shape, _ in whosmat(str(path))), default=0)
        except TypeError:  # scipy before 1.18 finds no size of an object
            largest = 0
        if largest > most:
            raise fault(path, "", f"an array of {largest} numbers; expected a record, {most} at most")
        warnings.simplefilter("ignore", MatReadWarning)  # of several objects, which `_objects` reports
        return loadmat(str(path), squeeze_me=True, struct_as_record=False, chars_as_strings=True)
    except Faults:
        raise
    except NotImplementedError:
        raise fault(path, "", "a .mat file of version 7.3; expected save(..., '-v7'), or a CSV file") from None
    except ArithmeticError:  # scipy reads a kind behind the end of its table, and divides by what stands there
        raise fault(path, "", BROKEN) from None
    except Exception as error:  # scipy raises whatever its parser meets in a broken file
        text = " ".join(str(error).split())[:200]
        kind = BROKEN if "cannot reshape" in text else f"cannot be read as .mat: {type(error).__name__}: {text}"
        raise fault(path, "", kind) from None


def _objects(content: Any, path: Path) -> list[tuple[str, str]]:
    """Return names and classes of MATLAB's objects, tables first."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque, varmats_from_mat

    if not any(isinstance(value, MatlabOpaque) for value in content.values()):
        return []
    found = []
    with path.open("rb") as file:
        for _, one in varmats_from_mat(file):
            for name, value in loadmat(cast(Any, one)).items():
                if isinstance(value, MatlabOpaque):
                    # before scipy 1.18: the name, then the system of the type, and the class
                    fields = list(cast(Any, value).flat[0])[:-1]
                    words = [each.decode() if isinstance(each, bytes) else str(each) for each in fields]
                    found.append((words[0] if len(words) > 2 else name, words[-1]))
    return sorted(found, key=lambda each: "table" not in each[1])


def _vectors(content: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield names and vectors of a file or a struct."""
    items = content.items() if isinstance(content, dict) else ((n, getattr(content, n)) for n in content._fieldnames)
    for name, value in items:
        values = np.asarray(value)
        if name.startswith("__"):
            continue
        if hasattr(value, "_fieldnames") and depth < DEEPEST:
            yield from _vectors(value, depth + 1)
        elif values.dtype.kind == "O" and values.size and all(hasattr(one, "_fieldnames") for one in values.flat):
            for field in values.flat[0]._fieldnames:
                if (column := _column([getattr(struct, field) for struct in values.flat])) is not None:
                    yield field, column
        elif values.dtype.kind in "OU" and values.ndim == 1 and (column := _column(list(values))) is not None:
            yield name, column  # a cell array, or a matrix of characters
        elif values.dtype.kind in NUMBERS and values.ndim == 1:
            yield name, values
        elif values.dtype.kind in NUMBERS and values.ndim == 2 and values.shape[1] <= MOST_COLUMNS:
            yield from ((f"{name}{k + 1}", values[:, k]) for k in range(values.shape[1]))


def _column(cells: list[Any]) -> Any | None:
    """Return numbers if each cell is one, text if some cell is a number or a text, else None."""
    values = [np.asarray(cell) for cell in cells]
    alone = [value.ndim == 0 and value.dtype.kind in NUMBERS for value in values]
    if values and all(alone):
        return np.array(values)
    if any(alone) or any(value.ndim == 0 and value.dtype.kind == "U" for value in values):
        return np.array([_as_text(value)[:LONGEST].strip() for value in values])
    return None


def _as_text(value: Any) -> str:
    if value.size == 0:
        return ""
    if value.ndim:
        return f"{value.size} values"
    return repr(float(value)) if value.dtype.kind in NUMBERS else str(value)
