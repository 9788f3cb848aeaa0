"""Commands that use an identified robot: payloads, external torques."""
