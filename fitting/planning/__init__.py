"""Planning of further recordings: what they would determine or separate."""
