"""Methods and solvers from the literature that are nowhere the best here: to compare with, by "module:Class"."""
