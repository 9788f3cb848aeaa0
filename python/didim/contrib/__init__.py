"""Methods and solvers from the literature for comparison, by "module:Class"; others are better in every benchmark here."""
