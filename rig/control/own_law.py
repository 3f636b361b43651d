"""A user-defined law in a run folder: its source file and its state at the start of each phase, for `peltier replay`.

The file is the module that the law's class was imported from. A class of the script itself, or of a notebook's cell,
is not kept: to import such a script again would run the experiment again.
"""

from __future__ import annotations

import base64
import inspect
import pickle
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from rig.control.decision import Policy
from rig.core.faults import fault

EXPECTED = "expected its class in a file of its own, which the script or notebook imports"


@dataclass(frozen=True)
class KeptLaw:
    """User-defined law in a run folder.

    file, text: the law's module. entries: of the event that begins its phase: how to make the law again, or why that is
    impossible.
    """

    file: str = ""
    text: str = ""
    entries: dict[str, str] = field(default_factory=dict)


def kept_law(policy: Policy) -> KeptLaw:
    """Return what a run folder keeps of a law to replay it; nothing for a law of this program."""
    kind = type(policy)
    if kind.__module__.partition(".")[0] == "rig":
        return KeptLaw()
    try:
        path = Path(inspect.getfile(kind))
        text = path.read_text(encoding="utf-8")
    except (TypeError, OSError, ValueError):
        return KeptLaw(entries={"not_kept": f"it stands in no file; {EXPECTED}"})
    if kind.__module__ == "__main__":
        return KeptLaw(entries={"not_kept": f"it stands in the script that ran; {EXPECTED}"})
    try:
        state = base64.b64encode(pickle.dumps(vars(policy))).decode()
    except Exception as error:  # whatever an attribute does when it is pickled
        return KeptLaw(entries={"not_kept": f"an attribute of it cannot be pickled ({error})"})
    return KeptLaw(path.name, text, {"law": f"{path.name}:{kind.__qualname__}", "state": state})


def law_of(folder: Path, phase: dict[str, Any]) -> Policy:
    """Return the law of a phase as it was when the phase began. phase: its event. Raises Faults."""
    file, _, name = str(phase["law"]).rpartition(":")
    path = folder / Path(file).name
    if not path.is_file():
        raise fault(path, "", "no such file; expected the law that ran")
    module = ModuleType(f"law_of_a_run_{path.stem}")
    sys.modules[module.__name__] = module  # where dataclasses look themselves up
    sys.path.insert(0, str(folder.absolute()))  # what it imports may have been put beside it
    try:
        exec(compile(path.read_bytes(), path, "exec"), vars(module))  # no __pycache__ in a run folder
        kind: Any = module
        for part in name.split("."):
            kind = getattr(kind, part)
        law = kind.__new__(kind)
        vars(law).update(pickle.loads(base64.b64decode(str(phase["state"]))))
    except Exception as error:  # whatever a user's file does when it is imported
        text = f"{name} cannot be made again: {type(error).__name__}: {error}"
        raise fault(path, "", f"{text}; expected the file as it ran, with what it imports beside it") from None
    finally:
        sys.path.remove(str(folder.absolute()))
    return law  # type: ignore[no-any-return]
