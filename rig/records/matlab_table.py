"""The vectors of numbers in a MATLAB file (.mat), read with scipy in a process of its own.

On some broken files scipy's reader does not raise but ends its whole process (a segmentation fault). Nothing that reads
a record may end that way, least of all a program that keeps a heater.
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
from rig.records.column_names import meaning_of
from rig.records.table import Table, array_table

MOST_COLUMNS = 1000  # of a matrix: more are a picture, not a record
MOST_NUMBERS = 250_000_000  # in one array of a file: 2 GB, which zeros are packed into 2 MB of
# by class what to type in MATLAB, and the column that it may be, without which it is needed
TO_TYPE = {
    "table": ("writetable({name}, '{stem}.csv')", "temperature_degC"),
    "timetable": ("writetimetable({name}, '{stem}.csv')", "temperature_degC"),
    "timeseries": (
        "time_s = {name}.Time; {name}_data = {name}.Data; save('{stem}.mat', 'time_s', '{name}_data', '-append')",
        "time_s",
    ),
    "datetime": ("time_s = seconds({name} - {name}(1)); save('{stem}.mat', 'time_s', '-append')", "time_s"),
    "duration": ("time_s = seconds({name}); save('{stem}.mat', 'time_s', '-append')", "time_s"),
    "": ("s = struct({name}); save('{stem}.mat', '-struct', 's', '-v7')", "temperature_degC"),
}
DEEPEST = 3  # structs inside each other
NUMBERS = "biuf"  # numpy's kinds of real numbers
LONGEST = 400  # characters of a text: no number or date has more, and each row takes as much as the longest
NO_SENSE = "cannot be read as .mat: its sizes and kinds do not fit its bytes"
READ = "import sys; sys.path[:] = {paths!r}; from rig.records.matlab_table import tell; tell(sys.argv[1], {most})"


def matlab_table(path: Path) -> Table:
    """The vectors of one length in a .mat file, in structs and arrays of them too. Raises Faults."""
    vectors, objects = vectors_of(path)
    meanings = {meaning_of(name).ours for name, _ in vectors}
    for name, kind in objects:
        told, needed = TO_TYPE.get(kind, TO_TYPE[""])
        if needed not in meanings or not meanings & {"temperature_degC", "current_A"}:
            what = told.format(name=name, stem=path.stem)
            raise fault(path, name, f"a MATLAB {kind}, which only MATLAB reads; expected, typed there: {what}")
    lengths = [values.size for _, values in vectors if values.size >= 2 and values.dtype.kind != "U"]
    if not lengths:
        text = "in a struct or beside each other, or an array of structs with a number in each field"
        raise fault(path, "", f"no vectors of numbers; expected one for each column, {text}")
    lengths += [values.size for name, values in vectors if meaning_of(name).ours is not None]  # each counts twice
    rows = max(set(lengths) - {0, 1}, key=lambda n: (lengths.count(n), n))
    chosen = [(name, values) for name, values in vectors if values.size == rows]
    names = [name for name, _ in chosen]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise Faults([f"{path}: {name!r} appears in more than one struct; expected each name once" for name in twice])
    table = array_table(dict(chosen), str(path))
    left = sorted({name for name, values in vectors if values.size not in (1, rows)})
    if objects:
        table.said.append(f"MATLAB objects left: {', '.join(name for name, _ in objects)}")
    if left:
        table.said.append(f"of another length and left: {', '.join(left[:8])}")
    return table


def vectors_of(path: Path) -> tuple[list[tuple[str, Array]], list[tuple[str, str]]]:
    """Return names and vectors, and names and classes of MATLAB's objects, which are not read. A matrix gives a vector
    for each of its columns, an array of structs one for each of its fields: of text where there is text, as in a cell
    array of it, or where there are no or several numbers. Raises Faults."""
    if not path.is_file():
        raise fault(path, "", "no such file")
    command = [sys.executable, "-c", READ.format(paths=sys.path, most=MOST_NUMBERS), str(path)]
    child = subprocess.run(command, capture_output=True, check=False)
    if child.returncode == 2:
        raise Faults(child.stderr.decode(errors="replace").strip().splitlines()[-1:])
    if child.returncode != 0:
        raise fault(path, "", NO_SENSE)
    with np.load(io.BytesIO(child.stdout), allow_pickle=False) as content:
        names = [str(name) for name in content["names"]]
        vectors = [(name, content[f"vector{k}"]) for k, name in enumerate(names)]
        return vectors, [(str(name), str(kind)) for name, kind in content["objects"]]


def tell(path: str, most: int) -> None:
    """In the process of its own: the vectors as .npz on stdout, or a line on stderr and exit status 2."""
    try:
        content = _content(Path(path), most)
        found, objects = list(_vectors(content)), _objects(content, Path(path))
    except Faults as faults:
        print(str(faults), file=sys.stderr)
        sys.exit(2)
    out = io.BytesIO()
    vectors = {f"vector{k}": values for k, (_, values) in enumerate(found)}
    kinds = np.array(objects, dtype=str).reshape(-1, 2)
    np.savez(out, names=np.array([name for name, _ in found], dtype=str), objects=kinds, **vectors)
    sys.stdout.buffer.write(out.getvalue())


def _content(path: Path, most: int) -> Any:
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadWarning

    try:
        try:
            largest = max((math.prod(shape) for _, shape, _ in whosmat(str(path))), default=0)
        except TypeError:  # scipy before 1.18 knows no sizes beside an object
            largest = 0
        if largest > most:
            raise fault(path, "", f"an array of {largest} numbers; expected a record, {most} at most")
        warnings.simplefilter("ignore", MatReadWarning)  # of several objects, which `_objects` tells apart
        return loadmat(str(path), squeeze_me=True, struct_as_record=False, chars_as_strings=True)
    except Faults:
        raise
    except NotImplementedError:
        raise fault(path, "", "a .mat file of version 7.3; expected save(..., '-v7'), or a CSV file") from None
    except ArithmeticError:  # scipy has looked a kind up behind the end of its table, and divides by what stood there
        raise fault(path, "", NO_SENSE) from None
    except Exception as error:  # scipy raises what its parser happened to meet in a broken file
        text = " ".join(str(error).split())[:200]
        if "cannot reshape" in text:  # of that kind, too, numbers that take no bytes
            raise fault(path, "", NO_SENSE) from None
        raise fault(path, "", f"cannot be read as .mat: {type(error).__name__}: {text}") from None


def _objects(content: Any, path: Path) -> list[tuple[str, str]]:
    """Names and classes of what is an object of MATLAB's: scipy does not read what is in it."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque, varmats_from_mat

    if not any(isinstance(value, MatlabOpaque) for value in content.values()):
        return []
    found = []
    with path.open("rb") as file:
        for _, one in varmats_from_mat(file):
            variables: dict[str, Any] = loadmat(cast(Any, one))
            for name, value in variables.items():
                if isinstance(value, MatlabOpaque):
                    fields = list(
                        cast(Any, value).flat[0]
                    )  # before scipy 1.18 its name, then the type's system, and the class
                    words = [each.decode() if isinstance(each, bytes) else str(each) for each in fields[:-1]]
                    found.append((words[0] if len(words) > 2 else name, words[-1]))
    return sorted(found, key=lambda each: "table" not in each[1])  # the rows are in it


def _vectors(content: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    items = content.items() if isinstance(content, dict) else ((n, getattr(content, n)) for n in content._fieldnames)
    for name, value in items:
        if name.startswith("__"):
            continue
        if hasattr(value, "_fieldnames") and depth < DEEPEST:
            yield from _vectors(value, depth + 1)
            continue
        values = np.asarray(value)
        if values.dtype.kind == "O" and values.size and all(hasattr(one, "_fieldnames") for one in values.flat):
            yield from _rows(list(values.flat))
        elif values.dtype.kind in "OU" and values.ndim == 1 and (column := _column(list(values))) is not None:
            yield name, column  # a cell array, or a matrix of characters
        if values.dtype.kind not in NUMBERS:
            continue
        if values.ndim == 1:
            yield name, values
        elif values.ndim == 2 and values.shape[1] <= MOST_COLUMNS:
            yield from ((f"{name}{k + 1}", values[:, k]) for k in range(values.shape[1]))


def _rows(structs: list[Any]) -> Iterator[tuple[str, Any]]:
    """Of an array of structs, a row each, the fields that are a column."""
    for field in structs[0]._fieldnames:
        if (column := _column([getattr(struct, field) for struct in structs])) is not None:
            yield field, column


def _column(cells: list[Any]) -> Any | None:
    """Numbers, where each cell is one; text, where some cell is a number or a text; else None."""
    values = [np.asarray(cell) for cell in cells]
    alone = [value.ndim == 0 and value.dtype.kind in NUMBERS for value in values]
    if values and all(alone):
        return np.array(values)
    if any(alone) or any(value.ndim == 0 and value.dtype.kind == "U" for value in values):
        return np.array([_in_words(value)[:LONGEST].strip() for value in values])
    return None


def _in_words(value: Any) -> str:
    if value.size == 0:
        return ""
    if value.ndim:
        return f"{value.size} values"
    return repr(float(value)) if value.dtype.kind in NUMBERS else str(value)
