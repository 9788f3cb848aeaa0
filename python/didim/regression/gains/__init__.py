"""Drive gains: currents as the measured output, with at least one partly known payload."""
