"""The report of `peltier tune`: margins over the film's slope, Nyquist curves, sensitivity."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from compensator.control.margins import bearable_ms, frequencies, judged, worst_ms
from rig.records.run_folder import plain_json
from rig.report import page

if TYPE_CHECKING:
    from rig.experiment.tuning import WholeLaw

# film slope over model slope, with its colour: right, the bounds of "Ms 1.6", and the largest judged
SHOWN = {0.6: page.PURPLE, 1.0: page.BLUE, 1.5: page.GREEN, 2.2: page.GOLD}


def write_tuning_report(folder: Path, name: str, result: Mapping[str, Any], found: WholeLaw) -> None:
    """Write report.html, tuning.json and the figures into `folder`."""
    (folder / "tuning.json").write_text(plain_json(result) + "\n", encoding="utf-8")
    worst = max(row.margins.ms for row in found.rows)
    verdict = "The margins hold." if not found.refused else "The gains are refused: their margins do not hold."
    place = "ohmmeter" if found.name == "instrument_pid" else "command"
    usual = max(r.margins.ms for r in found.rows if r.ratio <= 1.5)
    numbers = [
        (f"{usual:.2f}", "maximum sensitivity Ms, slope ratios 0.6 to 1.5"),
        (f"{worst:.2f}", "Ms at all ratios"),
        (f"{found.rings_at_ratio:.2f}", "slope ratio at which the loop is unstable"),
        (f"{found.rings_at_gain:.2f}", "plate gain, relative to the model's, at which the loop is unstable"),
    ]
    parts = [
        page.tiles(numbers),
        page.section(f"The loop, broken at the {place}", _figure(folder, found)),
        page.section("Margins", _table(found), page.paragraph(_MEANING)),
    ]
    if found.refused:
        parts.insert(0, page.section("Refused", page.bullets(found.refused)))
    own = result["instrument_pid_gains"]
    if own["options"] is not None:
        lines = [f"{key} = {value:g}" for key, value in own["options"].items()] + list(own["commands"])
        parts.append(page.section("Gains for the controller's own PID", page.bullets(lines)))
    page.write_page(folder / "report.html", f"{name}: margins of the law '{found.name}'", verdict, parts)


_MEANING = (
    "Slope ratio: slope of the film over that of its model, which differ on minor loops. Ms: peak sensitivity; 1 / Ms "
    "is the smallest distance of the loop's Nyquist curve from -1. The gain margin is the factor by which the loop's "
    "gain may be wrong, the disk margin the factor and the phase by which both may be wrong together. Each number is "
    "the worst of heating and cooling branch, with a quiet and with a typical thermometer. A film at rest is drawn "
    "without a limit: within the dead band the resistance is not fed back."
)


def _table(found: WholeLaw) -> str:
    head = ["slope ratio", "gain margin", "phase margin / deg", "Ms", "largest allowed Ms", "Ms at the ohmmeter"]
    rows = []
    for ratio, m in ((row.ratio, row.margins) for row in found.rows):
        disk = f"{m.disk_gain:.2f}, {m.disk_phase_deg:.0f} deg"
        loop = [f"{m.gain_margin:.2f}", f"{m.phase_margin_deg:.0f}", f"{m.ms:.2f}", f"{bearable_ms(ratio):g}"]
        rows.append([f"{ratio:g}", *loop, f"{m.at_ohmmeter:.2f}", disk])
    return page.table([*head, "disk: gain, phase"], rows)


def _figure(folder: Path, found: WholeLaw) -> str:
    """Draw Nyquist curve and |S| at the operating point with the smallest margins, for some slope ratios; return the
    page's figure."""
    fig, axes = page.grid(1, 2, 4.4)
    nyquist, bode = axes[0]
    omega = frequencies(found.timing.period_s)
    curves = [(ratio, f"slope ratio {ratio:g}", shade) for ratio, shade in SHOWN.items()]
    for ratio, label, shade in [*curves, (1.0, "at rest", page.RED)]:
        points = [p for p in found.points if (p.way == "at rest") == (label == "at rest")]
        point = max(points, key=lambda p, ratio=ratio: worst_ms([p], ratio))  # type: ignore[misc]
        loop = judged(point, ratio, omega)
        nyquist.plot(loop.real, loop.imag, color=shade, label=label)
        bode.plot(omega, 1.0 / np.abs(1.0 + loop), color=shade, label=label)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    for ms, style, side in ((1.6, "--", 1.0), (2.0, ":", -1.0)):
        nyquist.plot(-1.0 + np.cos(angle) / ms, np.sin(angle) / ms, style, color=page.EDGE, linewidth=1.0)
        nyquist.annotate(f"Ms {ms:g}", (-1.0, side / ms), ha="center", va="bottom", fontsize=8.5, color=page.SOFT)
        bode.axhline(ms, linestyle=style, color=page.EDGE, linewidth=1.0)
    nyquist.plot([-1.0], [0.0], "+", color=page.INK, markersize=9)
    nyquist.set(xlim=(-2.5, 1.0), ylim=(-2.5, 1.0), xlabel="Re L", ylabel="Im L", aspect="equal")
    bode.set(
        xscale="log", xlabel="frequency / rad/s", ylabel="|S| = |1 / (1 + L)|", xlim=(1e-2, omega[-1]), ylim=(0.0, 2.5)
    )
    bode.legend(loc="upper left")
    caption = (
        "Left: Nyquist curves of the whole loop, and the circles of radius 1 / Ms about -1 that they must not "
        "enter. Right: sensitivity, the factor by which the loop changes an error at each frequency."
    )
    return page.saved(fig, folder, "margins", caption)
