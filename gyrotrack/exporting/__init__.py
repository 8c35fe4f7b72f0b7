"""Handing data on to other programs: plain columns, and CSV, Parquet and netCDF files made of them."""

from __future__ import annotations

from gyrotrack.exporting.columns import TABLES, Column, columns, to_dataframe
from gyrotrack.exporting.files import FORMATS, export_file

__all__ = ["FORMATS", "TABLES", "Column", "columns", "export_file", "to_dataframe"]
