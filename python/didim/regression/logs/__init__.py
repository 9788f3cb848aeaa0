"""Several logs of one robot: common parameters, and parameters of single logs."""
