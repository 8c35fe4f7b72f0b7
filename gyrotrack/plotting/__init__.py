"""Figures: every curve is drawn here once, for report, figures, workbench and notebook."""
