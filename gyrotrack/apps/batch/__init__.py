"""Batches: many films and cases, processed unattended and resumable."""
