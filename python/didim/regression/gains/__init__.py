"""Drive gains: currents as the measured output, with at least one payload of which something is known."""
