"""Studies made with methods: comparison, prediction, validation, simulation."""
