"""Import Python's modules, the installed packages and ours before whatever lies in a user's folder.

A user's own `serial.py`, `numpy.py` or `rig.py` beside the work is an everyday thing. Python looks there first: it
takes the file for the package, runs it, and the program that wanted the package fails, a STOP included.

Each Python that `./peltier` or the installed `peltier` starts, and each that those start, comes here before its first
import: this folder is their PYTHONPATH (Python library, site: `sitecustomize`). Nothing is imported here that Python
has not loaded by then.
"""

import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

FOLDER = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(FOLDER))
PathFinder = sys.modules["_frozen_importlib_external"].PathFinder  # `importlib` may be somebody's file
OURS = ("rig", "sim", "compensator")
USERS = "PELTIER_PYTHONPATH"  # the user's own PYTHONPATH: it comes last


class _TrustedFirst:
    """Find a top-level module in the trusted folders, whatever `sys.path` has before them.

    In a verb (PYTHONSAFEPATH: the working folder is not on the path), a module of Python's that this system lacks, such
    as `msvcrt`, is not looked for elsewhere.
    """

    def __init__(self, trusted: "list[str]") -> None:
        self._trusted = trusted
        self._verb = bool(os.environ.get("PYTHONSAFEPATH"))
        self._told: set[str] = set()

    def find_spec(
        self, name: str, path: "Sequence[str] | None" = None, target: "ModuleType | None" = None
    ) -> "ModuleSpec | None":
        if path is not None:  # inside a package
            return None
        spec: ModuleSpec | None = PathFinder.find_spec(name, [ROOT] if name in OURS else self._trusted)
        if self._verb:
            if spec is None and name in sys.stdlib_module_names:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
            return spec
        if spec is None or spec.loader is None:  # a stray folder of a package may have any name, such as `examples`
            return None
        self._tell_of_another(name, spec)
        return spec

    def _tell_of_another(self, name: str, spec: "ModuleSpec") -> None:
        """Say once which file Python would have taken; `./peltier python` is for scripts with modules of their own."""
        other = PathFinder.find_spec(name)
        if other is None or other.loader is None or other.origin == spec.origin or name in self._told:
            return
        self._told.add(name)
        text = f"{other.origin} is not imported: {name!r} is the module {spec.origin}. Rename the file to import it."
        print(f"peltier: {text}", file=sys.stderr)


def trust(folders: "list[str]") -> None:
    """Put the folders before all others, and the user's own PYTHONPATH after all others."""
    before = sys.meta_path.index(PathFinder) if PathFinder in sys.meta_path else 0
    sys.meta_path.insert(before, _TrustedFirst(folders))
    users = os.environ.get(USERS, "").split(os.pathsep)
    sys.path += [user for user in users if os.path.isabs(user) and user not in sys.path]
