"""What Python does first where this folder is on PYTHONPATH (`import_order`)."""

import sys

if sys.version_info >= (3, 11):  # noqa: UP036 - another program's Python may be older, and is none of ours
    import import_order  # type: ignore[import-not-found]

    import_order.trust([folder for folder in sys.path if folder])
