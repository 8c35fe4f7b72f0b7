"""Fits, diagnoses and ladders as a notebook shows them: tables in HTML, and figures.

Matplotlib is imported when something is drawn, and not before.
"""
