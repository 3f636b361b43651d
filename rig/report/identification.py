"""The report of an identification: the model over the record, what it leaves, what the record says without a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.film_numbers import FilmNumbers
from rig.analysis.residual import residual
from rig.analysis.transition_words import forc_note, rows
from rig.core.file_writing import write_text
from rig.records.film_output import unit_of
from rig.records.run_folder import plain_json
from rig.report.model_figures import (
    ComparedPlate,
    derivative_figure,
    forc_figure,
    loop_figure,
    plate_figure,
    residual_figure,
)
from rig.report.page import bullets, paragraph, section, table, tiles, write_page


@dataclass(frozen=True, eq=False)
class Compared:
    """A record's film beside the model, arrays of shape (rows,): s, degC, output measured and modelled."""

    source: str
    time_s: Array
    degC: Array
    measured: Array
    modelled: Array


def write_identification_report(
    folder: Path,
    result: Mapping[str, Any],
    compared: Sequence[Compared],
    numbers: Sequence[FilmNumbers],
    output: str,
    plates: Sequence[ComparedPlate] = (),
) -> None:
    """report.html, identification.json and figures/ in a folder that is there."""
    write_text(folder / "identification.json", plain_json(result) + "\n")
    film, unit = result.get("film"), unit_of(output)
    parts: list[str] = []
    lead = f"From {', '.join(Path(source).name for source in result['records'])}."
    if film is not None:
        lead = f"The film model follows the record to {film[f'rmse_{unit}']:.4g} {unit} RMS. {lead}"
        parts.append(
            tiles(
                [
                    (f"{film[f'rmse_{unit}']:.4g} {unit}", "RMSE of the fit"),
                    (f"{film[f'held_out_rmse_{unit}']:.4g} {unit}", "RMSE on rows that were held out"),
                    (f"{film[f'max_abs_{unit}']:.3g} {unit}", "largest error"),
                    (f"{film['active_operators']}", f"operators with weight, {film['kind'].replace('_', ' ')}"),
                    (film["memoryless"], "form of D(T)"),
                ]
            )
        )
    if result.get("left_out"):
        gone = [
            f"{Path(out['record']).name}: rows {out['rows'][0]} to {out['rows'][1]} ({out['from_s']:.12g} to "
            f"{out['to_s']:.12g} s) read {out['reads_degC']:.6g} degC: {out['rule']}"
            for out in result["left_out"]
        ]
        parts.append(section("Temperatures that were left out", bullets(gone)))
    for k, (one, own) in enumerate(zip(compared, numbers, strict=True)):
        suffix = f"_{k + 1}" if len(compared) > 1 else ""
        name = f" of {Path(one.source).name}" if suffix else ""
        parts.append(transition_section(folder, own, suffix, f"The transition{name}"))
        left = residual(one.measured, one.modelled, output)
        parts.append(
            section(
                f"The model over the record{name}",
                loop_figure(folder, one.time_s, one.degC, one.measured, one.modelled, output, suffix),
                residual_figure(folder, one.time_s, one.degC, left, unit, suffix),
            )
        )
    if film is not None:
        notes = film["identifiability"]
        parts.append(
            section("What the record cannot fix", bullets(notes) if notes else paragraph("Nothing of the film."))
        )
    if "plate" in result:
        parts.append(_plate(folder, result["plate"], plates))
    write_page(folder / "report.html", "Film and plate from a record", lead, parts)


def _plate(folder: Path, plate: Mapping[str, Any], plates: Sequence[ComparedPlate]) -> str:
    parameters = [
        [name, f"{one['value']:.6g}", f"\N{PLUS-MINUS SIGN} {0.5 * np.ptp(one['ci95']):.2g}"]
        for name, one in plate["parameters"].items()
    ]
    figures = [plate_figure(folder, one, f"_{k + 1}" if len(plates) > 1 else "") for k, one in enumerate(plates)]
    kind = "Peltier plate" if plate["kind"] == "peltier" else "heater"
    fitted = (
        f"The model of a {kind} leaves {plate['rmse_K']:.3g} K RMS, {plate['max_abs_K']:.3g} K at most; "
        f"the thermometer's noise is {plate['noise_K']:.2g} K."
    )
    drive = " (per full drive in the place of A)" if plate["drive"] is not None else ""
    return section(
        "The plate",
        paragraph(fitted),
        *figures,
        table([f"parameter{drive}", "value", "95 %"], parameters),
        bullets(plate["identifiability"]),
    )


def transition_section(folder: Path, numbers: FilmNumbers, suffix: str = "", title: str = "The transition") -> str:
    """Of one record; suffix: of the figures' names, where a page shows several records."""
    found, forc = numbers.transition, numbers.forc
    parts = [
        table(
            ["what", "value and 95 % interval"],
            [[a, b.replace("+-", "\N{PLUS-MINUS SIGN}")] for a, b in rows(found, numbers.unit)],
        ),
        bullets(numbers.notes()),
    ]
    if found.shapes:
        parts.append(derivative_figure(folder, found, f"derivative{suffix}", numbers.unit))
    if forc.reason or not np.any(np.isfinite(forc.density)):
        parts.append(paragraph(forc_note(forc), "note"))
    else:
        parts.append(forc_figure(folder, forc, f"forc{suffix}"))
    return section(title, *parts)
