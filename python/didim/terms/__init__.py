"""Terms of the torque of a log, their unknowns, and the linear system (7) that they make together."""
