"""Applications of methods: comparison, prediction, validation, simulation."""
