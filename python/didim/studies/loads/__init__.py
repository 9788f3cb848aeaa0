"""Applications of an identified robot: unknown payloads, external torques."""
