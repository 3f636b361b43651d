"""One record written in sixty ways: how many are read right as they are, and how many with what the refusal prints.

    python benchmarks/files.py [--seeds N] [--first SEED] [--show]

Asked: 30 of the first 40 read right without a flag, 58 of 60 with at most one flag, none wrong in silence. Read right:
every column that was written is there, and its values are the truth's to the file's digits. A flag is a line that the
refusal printed, typed as it stands; where it offers several units, whoever wrote the file takes the one that it is in.
Wrong in silence: read without a refusal, and a value is another one, or a column that was written is missing and no
line says so.
"""

from __future__ import annotations

import argparse
import re
import shlex
import sys
import tempfile
from pathlib import Path

import numpy as np
from _files_further_ways import FURTHER_WAYS
from _files_truth import Way, truth_of
from _files_ways import WAYS as FIRST_WAYS

from rig.core.faults import Faults
from rig.records.column_names import ColumnMapping
from rig.records.record_file import Record, read_record

WAYS = (*FIRST_WAYS, *FURTHER_WAYS)
ASKED_PLAIN, ASKED_FLAG = 30, 58
FLAG = re.compile(r"--column (?:'[^']*'|\S+)")


def wrong(record: Record, way: Way) -> str:
    """What is not as it was written; '' where nothing is."""
    for name, (values, slack) in way.expected.items():
        if name not in record.columns:
            told = any(name in line or "left" in line for line in record.notes)
            return f"{name} missing{'' if told else ' in silence'}"
        found = record[name]
        if found.shape != values.shape:
            return f"{found.size} rows of {values.size} in silence"
        if name.endswith("time_s"):  # clocks begin anywhere, and all of a record with the first row
            begin = record["time_s"][0], way.expected["time_s"][0][0]
            found, values = found - begin[0], values - begin[1]
        same = np.isfinite(values)
        if not np.array_equal(np.isfinite(found), same) or not np.array_equal(np.isinf(found), np.isinf(values)):
            return f"{name}: readings and gaps mixed up in silence"
        found, values, slack = found[same], values[same], slack[same]
        if name.endswith("time_s"):  # both ends of a time from the first row are rounded
            slack = 2.0 * slack + 1e-9
        off = np.abs(found - values) - slack
        if np.any(off > 0.0):
            k = int(np.argmax(off))
            return f"{name}: {found[k]:.6g} for {values[k]:.6g} in silence"
    if (record.drive is not None) != way.drive:
        return "a share of full drive as amperes in silence"
    return ""


def typed_by_the_writer(refusal: str, way: Way) -> list[str]:
    """The printed lines that somebody types who knows the units of the file: for each of our columns the one offered
    in the right unit, else the first."""
    offered: dict[str, list[str]] = {}
    for text in FLAG.findall(refusal):
        mapping = shlex.split(text)[1]
        offered.setdefault(mapping.partition("=")[0], []).append(mapping)
    chosen = []
    for ours, mappings in offered.items():
        if ours not in (*way.expected, "time_s"):
            continue
        unit = way.units.get(ours)
        suited = [m for m in mappings if unit is not None and m.rpartition("@")[2] == unit]
        chosen.append((suited or mappings)[0])
    return chosen


def judged(way: Way, folder: Path, show: bool) -> str:
    """'plain', 'flag', 'refused', or what is wrong."""
    path = folder / way.file
    path.write_bytes(way.content)
    flags: list[str] = []
    try:
        record = read_record(path, needs=("temperature_degC",))
    except Faults as refusal:
        flags = typed_by_the_writer(str(refusal), way)
        if show:
            print(f"    {refusal}".replace(f"{folder}/", ""))
        if not flags:
            return "refused, nothing to type"
        try:
            record = read_record(path, [ColumnMapping.parse(text) for text in flags], ("temperature_degC",))
        except Faults as again:
            if show:
                print(f"    typed {flags}: {again}".replace(f"{folder}/", ""))
            return "refused again"
    if show:
        print("".join(f"    {line}\n" for line in record.notes), end="")
    return wrong(record, way) or ("flag" if flags else "plain")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="records to write in each way (3)")
    parser.add_argument("--first", type=int, default=100, help="the first seed (100)")
    parser.add_argument("--show", action="store_true", help="what the reader says of each file")
    options = parser.parse_args()
    met = True
    for seed in range(options.first, options.first + options.seeds):
        found: list[str] = []
        with tempfile.TemporaryDirectory() as folder:
            for write in WAYS:
                way = write(truth_of(seed))
                found.append(judged(way, Path(folder), options.show))
                if options.show or found[-1] != "plain":
                    print(f"  {way.name:<58} {found[-1]}")
        first = found[: len(FIRST_WAYS)].count("plain")
        plain, flag = found.count("plain"), found.count("flag")
        silent = sum("in silence" in each for each in found)
        print(
            f"seed {seed}: {len(WAYS)} ways: {plain} read right as they are ({first} of the first {len(FIRST_WAYS)}, "
            f"asked {ASKED_PLAIN}), "
            f"{plain + flag} with at most one flag (asked {ASKED_FLAG}), {silent} wrong in silence (asked 0)"
        )
        met = met and first >= ASKED_PLAIN and plain + flag >= ASKED_FLAG and silent == 0
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
