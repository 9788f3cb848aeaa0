"""Commands of studies: many identifications in one run."""
