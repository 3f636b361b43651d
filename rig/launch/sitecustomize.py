"""What Python does first where this folder is on PYTHONPATH (`import_order`)."""

import sys

import import_order  # type: ignore[import-not-found]

import_order.trust([folder for folder in sys.path if folder])
