"""Commands on robots: files, base parameters and pictures."""
