"""Words of families of findings."""
