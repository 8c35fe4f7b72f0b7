"""Figures and charts, for report, paper figures, workbench and notebook."""
