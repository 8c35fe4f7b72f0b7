"""Write docs/reference/tracking_settings.md from the modules: `python docs/make_tracking_settings.py`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from gyrotrack._tracking_settings import ORIGINS, Setting, tracking_settings

TARGET = Path(__file__).parent / "reference" / "tracking_settings.md"

_HEAD = """# Settings of tracking

This page is generated from the modules by `docs/make_tracking_settings.py`. `gyrotrack config --tracking` prints the
same numbers, with `--json` as data.

Every number by which tracking, video and synchronisation decide is a constant of a module. Its unit is 1 for a ratio or
a count. Its origin is one of four: *derived* from a formula or a reason; *measured* on films; a *source*, which is a
publication or a standard; *chosen*, a convention or a trade-off, with what happens at other values.
"""


def page() -> str:
    """Return the text of the page."""
    settings = tracking_settings()
    count = Counter(s.origin.partition(":")[0] for s in settings)
    parts = [
        _HEAD,
        f"Of {count.total()} numbers {', '.join(f'{count[o]} are {_WORDS[o]}' for o in ORIGINS)}.",
    ]
    for module, own in settings.by_module().items():
        head = f"\n## {module}\n\n| name | value | unit | meaning | origin |\n|---|---|---|---|---|"
        parts += [head, *map(_row, own)]
    return "\n".join([*parts, ""])


_WORDS = {"derived": "derived", "measured": "measured", "source": "from a source", "chosen": "chosen"}


def _row(s: Setting) -> str:
    cells = (f"`{s.name}`", s.value_text, s.unit, s.meaning, s.origin)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
