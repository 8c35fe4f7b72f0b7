"""The workbench: a page on this machine only, where a case is looked at and effects are tried.

`session` holds the fits, `films` the frames, `ranking` looks for what is missing in a process of its own,
`guard` lets nobody in but the page that was opened, `server` joins them.
"""

from __future__ import annotations

from gyrotrack.view.server import Workbench, serve

__all__ = ["Workbench", "serve"]
