"""Monte Carlo studies: many simulated logs identified by several methods, on any executor of `concurrent.futures`."""
