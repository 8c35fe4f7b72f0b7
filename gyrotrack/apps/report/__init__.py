"""The report: one self-contained HTML file, or a PDF."""
