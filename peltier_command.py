"""The installed command `peltier`, in a module whose name is nobody else's: `rig` may be on a user's path, too."""

import os
import sys

FOLDER = os.path.dirname(os.path.abspath(__file__))


def main() -> int:
    """Run a verb with what is installed, whatever lies in the working folder and where PYTHONPATH says."""
    launch = os.path.join(FOLDER, "rig", "launch")
    users = os.environ.get("PYTHONPATH", "")
    sys.path.insert(0, launch)
    import import_order

    if users != launch:
        os.environ.update({import_order.USERS: users, "PYTHONPATH": launch, "PYTHONSAFEPATH": "1"})
        script = [] if sys.flags.safe_path else sys.path[1:2]
        last = {os.path.abspath(folder) for folder in [*users.split(os.pathsep), *script]} - {FOLDER}
        pythons = os.path.dirname(os.__file__)  # its own folders, should PYTHONPATH name them
        sys.path[:] = [at for at in sys.path if at.startswith(pythons) or os.path.abspath(at) not in last]
        import_order.trust(list(sys.path))
    from rig.__main__ import main as command

    return command()
