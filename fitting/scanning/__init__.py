"""Every on/off combination of the paper's terms on some cases, its two models, and how steady the numbers are."""

from fitting.scanning.document import scan_document
from fitting.scanning.ranges import paper_ranges
from fitting.scanning.robustness import Robustness, robustness
from fitting.scanning.runs import AIR, BEARING, COLUMNS, Column, Run, shade
from fitting.scanning.scan import ModelFits, Row, Scan, scan

__all__ = [
    "AIR",
    "BEARING",
    "COLUMNS",
    "Column",
    "ModelFits",
    "Robustness",
    "Row",
    "Run",
    "Scan",
    "paper_ranges",
    "robustness",
    "scan",
    "scan_document",
    "shade",
]
