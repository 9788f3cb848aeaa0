"""Search for the best series: a quasi-Newton descent, perturbations of the best motion, and several starts in parallel."""
