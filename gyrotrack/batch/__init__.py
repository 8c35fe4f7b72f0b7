"""Many films and cases, unattended: what is to be done, what was done already, and doing the rest."""

from __future__ import annotations
