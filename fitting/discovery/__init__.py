"""Which effect is missing: score every candidate, refit the best, say what cannot be told apart, go on."""

from fitting.discovery.improve import Ladder, Rung, improve
from fitting.discovery.ranking import Candidate, rank
from fitting.discovery.start import found_starts, needs_search
from fitting.discovery.verdict import Diagnosis, diagnose

__all__ = [
    "Candidate",
    "Diagnosis",
    "Ladder",
    "Rung",
    "diagnose",
    "found_starts",
    "improve",
    "needs_search",
    "rank",
]
