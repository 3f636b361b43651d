"""The report of `peltier improve`: what was found, the error before and after, and the gain, on one page."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.analysis.error import TargetError
from rig.experiment.improvement import Gain, as_effects
from rig.report import page
from rig.report.diagnosis_words import listed, parameter

FORMAT = "peltier-improvement/1"


@dataclass(frozen=True)
class Improvement:
    """The result of `peltier improve`.

    run: folder of the first run; folder: of the result; law: of the second run. diagnosis: its JSON; verdict_line: its
    verdict in words; new: the named effects that the first run's model did not have; tried: those that are not named
    and predict better, if none is new. model: file of the model with them. second: folder of the second run, None if it
    was not run, and why_not. caveats: why the errors may not be compared.
    """

    run: Path
    folder: Path
    law: str
    diagnosis: Mapping[str, Any]
    verdict_line: str
    new: Sequence[str]
    tried: Sequence[str]
    model: Path
    first: TargetError | None
    second: Path | None = None
    after: TargetError | None = None
    gained: Gain | None = None
    why_not: str | None = None
    caveats: Sequence[str] = field(default_factory=tuple)

    def document(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            **{key: getattr(self, key) for key in ("run", "folder", "law", "model")},
            **{key: list(getattr(self, key)) for key in ("new", "tried", "caveats")},
            "verdict": self.diagnosis["verdict"],
            "effects": [{key: e[key] for key in ("name", "parameters")} for e in self.diagnosis["effects"]],
            "first": None if self.first is None else self.first.document(),
            "second": None if self.after is None else self.after.document(),
            "reduction": None if self.gained is None else self.gained.reduction,
            "reduction_ci95": None if self.gained is None else list(self.gained.ci95),
            "second_run": self.second,
            "not_run_because": self.why_not,
        }


def sentence(i: Improvement) -> str:
    """Return the result in a sentence."""
    if i.why_not is not None:
        return f"Not run again: {i.why_not}."
    if i.tried:
        effects = f"{listed(i.diagnosis['candidates'][0]['names'])} (found, and not named)"
    else:
        effects = listed([str(e["name"]) for e in i.diagnosis["effects"]])
        effects += "" if i.new else " (which it had), and film and plate fitted to the first run,"
    if i.after is None:
        return f"Run again with {effects} in the model; no row of it followed a target."
    text = f"With {effects} in the model the RMS error is {_size(i.after.rms, i.after.unit)}"
    if i.first is None or i.first.unit != i.after.unit:
        return f"{text}; the first run has none to compare."
    text += f" in the place of {i.first.rms:.4f}"
    return f"{text}: {i.gained.in_words}." if i.gained is not None else f"{text}."


def _size(error: float, unit: str) -> str:
    return f"{error:.4f} {'decades' if unit == 'dec' else unit}"


def lines(i: Improvement) -> list[str]:
    """Return the result in lines for a terminal."""
    out = [sentence(i), *(f"note: {text}" for text in i.caveats)]
    if i.first is not None and i.after is not None and i.first.unit == i.after.unit:
        out.append(f"largest error: {_size(i.after.largest, i.after.unit)}, was {i.first.largest:.4f}")
    return out


def write_improvement(i: Improvement) -> None:
    """Write report.html and its figure into the folder, which is there."""
    parts = [page.paragraph(f"First run: {i.run}. Law {i.law!r}.", "note"), page.tiles(_numbers(i))]
    parts.append(page.section("What was found", page.paragraph(i.verdict_line), _effects(i)))
    if i.caveats:
        parts.append(page.section("To be kept in mind", *(page.paragraph(text) for text in i.caveats)))
    if i.first is not None and i.after is not None and i.first.unit == i.after.unit:
        parts.append(page.section("The error, before and after", _courses(i.folder, i.first, i.after)))
    parts.append(page.section("Further reports", page.links(_reports(i))))
    page.write_page(i.folder / "report.html", f"Improvement of {i.run.name}", sentence(i), parts)


def _numbers(i: Improvement) -> list[tuple[str, str]]:
    found = [(str(i.diagnosis["verdict"]).replace("_", " "), "verdict of the diagnosis")]
    for run, what in ((i.first, "first run"), (i.after, "second run")):
        if run is not None:
            found.append((_size(run.rms, run.unit), f"RMS error of the {what}"))
    if i.gained is not None:
        low, high = (100.0 * value for value in i.gained.ci95)
        found.append((f"{100.0 * i.gained.reduction:.0f} %", f"less error (95 %: {low:.0f} to {high:.0f} %)"))
    return found


def _effects(i: Improvement) -> str:
    effects, new = i.diagnosis["effects"], "new"
    if i.tried:
        effects, new = as_effects(i.diagnosis["candidates"][0]), "found, not named, and tried"
    if not effects:
        return page.paragraph("No effect is named.")
    rows = [
        [
            str(e["name"]),
            ", ".join(parameter(name, p["value"], p["ci95"]) for name, p in e["parameters"].items()),
            new if e["name"] in (*i.new, *i.tried) else "the first run's model had it",
        ]
        for e in effects
    ]
    return page.table(["effect", "parameters (95 % interval)", "in the model"], rows, kind="words")


def _courses(out: Path, first: TargetError, after: TargetError) -> str:
    """Draw both errors over the target's time, on one scale; return the page's figure."""
    fig, axes = page.new_figure(2, 5.0)
    most = 1.08 * max(first.largest, after.largest)
    for axis, run, what, colour in zip(axes, (first, after), ("before", "after"), ("pid", "full"), strict=True):
        axis.axhline(0.0, color=page.EDGE, linewidth=0.6)
        page.draw_line(axis, run.time_s, run.error, color=page.COLOURS[colour], linewidth=1.0)
        axis.set_ylim(-most, most)
        axis.set_ylabel(f"{what}: measured\n- wanted / {run.unit}")
    axes[-1].set_xlabel("time of the target / s")
    quantity = {"dec": "log10 R", "K": "temperature"}.get(first.unit, "output")
    text = f"The error over time, measured - wanted {quantity}: of the first run, and with the "
    text += "extended model. Both have the same scale."
    return page.saved(fig, out, "errors", text)


def _reports(i: Improvement) -> list[tuple[str, str]]:
    places = [("first run", i.run), ("diagnosis", i.folder / "diagnosis"), ("second run", i.second)]
    found = [(what, (folder / "report.html").absolute()) for what, folder in places if folder is not None]
    whole = [(what, os.path.relpath(path, i.folder.absolute())) for what, path in found if path.is_file()]
    return [(what, Path(path).as_posix()) for what, path in whole]
