"""The closed loop as evidence: the declared law along the log, and the simulated robot beside the measured one."""
