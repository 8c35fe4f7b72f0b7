"""Comparison of recordings: differences of parameters, and models of many recordings."""
