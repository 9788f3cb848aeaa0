"""Several logs of one robot: parameters that they share, and those of some of them alone."""
