"""Tools that know nothing of robotics."""
