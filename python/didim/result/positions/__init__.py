"""Results of CLOE with known links: the record, and its tables."""
