"""What was found, to be seen: one HTML file that needs nothing else, and the picture of the story.

`write_report` collects what is to be shown (`content`), draws it (`figures`), and fills one page (`page`).
"""

from __future__ import annotations

from gyrotrack.report.page import write_report
from gyrotrack.report.story import story_picture

__all__ = ["story_picture", "write_report"]
