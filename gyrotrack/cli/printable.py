"""Text that a terminal shows and does not obey: names in files may hold control characters."""

from __future__ import annotations

import re

# C0 and C1 controls but line feed and tab; marks that reorder or hide what is written; line separators
_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028\u2029\u202a-\u202e\u2060-\u2069\ufeff]"
)


def printable(text: str) -> str:
    r"""Return `text` with control and direction characters written out, as ``\x1b``.

    Examples
    --------
    >>> printable("a\x1b[31mb")
    'a\\x1b[31mb'
    """
    return _COMMANDS.sub(lambda found: ascii(found[0])[1:-1], text.encode("utf-8", "replace").decode())
