"""Files: the HDF5 schema, reading, writing, validation, import and export."""
