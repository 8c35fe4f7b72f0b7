"""Write the pages of settings in docs/reference from the modules: `python docs/make_settings.py`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from fitting._settings import ORIGINS, Setting, Settings, fitting_settings
from gyrotrack._tracking_settings import tracking_settings

_REFERENCE = Path(__file__).parent / "reference"

_HEAD = """# Settings of {kind}

This page is generated from the modules by `docs/make_settings.py`. `gyrotrack config --{kind}` prints the same numbers,
with `--json` as data.

{what}

The unit is 1 for a ratio or a count. The origin is one of four: *derived* from a formula or a reason; *measured* on
{data}; a *source*, which is a publication or a standard; *chosen*, a convention or a trade-off, with the effect of
other values.
"""
_TRACKING = "Every number on which tracking, video and synchronisation depend is a constant of a module."
_FITTING = """Every number on which fits, noise estimates, searches and verdicts depend is a constant of a module or a
field of `fitting.Criteria`, which can be changed in Python. [Method](../explanation/method.md) cites the paper."""
_WORDS = {"derived": "derived", "measured": "measured", "source": "from a source", "chosen": "chosen"}


def pages() -> dict[Path, str]:
    """Return the text of each page."""
    tracking = _HEAD.format(kind="tracking", what=_TRACKING, data="films")
    fitting = _HEAD.format(kind="fitting", what=_FITTING, data="recordings or simulations")
    return {
        _REFERENCE / "tracking_settings.md": _page(tracking, tracking_settings()),
        _REFERENCE / "fitting_settings.md": _page(fitting, fitting_settings()),
    }


def _page(head: str, settings: Settings) -> str:
    count = Counter(s.origin.partition(":")[0] for s in settings)
    parts = [
        head,
        f"Of {count.total()} numbers, {', '.join(f'{count[o]} are {_WORDS[o]}' for o in ORIGINS)}.",
    ]
    for module, own in settings.by_module().items():
        title = f"\n## {module}\n\n| name | value | unit | meaning | origin |\n|---|---|---|---|---|"
        parts += [title, *map(_row, own)]
    return "\n".join([*parts, ""])


def _row(s: Setting) -> str:
    cells = (f"`{s.name}`", s.value_text, s.unit, s.meaning, s.origin)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


if __name__ == "__main__":
    for target, text in pages().items():
        target.write_text(text, encoding="utf-8")
