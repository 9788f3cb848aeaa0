"""Commands on robots alone: their files, base parameters and pictures."""
