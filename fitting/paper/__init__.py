"""The tables and figures of the paper: several models fitted to several recordings."""
