"""Studies: history of fits, serialisation, tables of the paper."""
