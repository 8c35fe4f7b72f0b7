"""Studies: history of fits, serialisation, preparation of the data as in the paper."""
