"""What stands on top of a model file that a diagnosis wrote: which of its numbers are doubtful, or not fixed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.report.diagnosis_records import together
from rig.report.diagnosis_words import NOT_FIXED, chosen_parameters
from sim.diagnosis.of_full_drive import SHARE
from sim.effects.memoryless_term import NAME as MEMORYLESS_TERM

if TYPE_CHECKING:
    from sim.diagnosis.result import Diagnosis


def model_comment(diagnosis: Diagnosis) -> str:
    """Lines of a diagnosis' extended model."""
    lines = [f"extended model of the diagnosis of {together(diagnosis)}", *unit_lines(diagnosis)]
    if diagnosis.plate is not None:
        lines += [f"plate: {doubt}" for doubt in diagnosis.plate.doubts]
    for finding in diagnosis.findings:
        if finding.name != MEMORYLESS_TERM:  # it is the film's, and no number of an effect
            chosen = chosen_parameters(finding)
            lines += [
                f"{finding.name}: {name}: {NOT_FIXED}"
                for name, (_, interval) in finding.parameters.items()
                if interval is None and name not in chosen
            ]
    return "\n".join(lines)


def unit_lines(diagnosis: Diagnosis) -> list[str]:
    """That A stands for the full drive, where it does."""
    return [warning.text for warning in diagnosis.warnings if warning.code == SHARE]
