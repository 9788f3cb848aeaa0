"""Classical regressions on the linear system, for comparison with the published toolboxes."""
