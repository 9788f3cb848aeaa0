"""A robot, its log, its closed loop and the settings, as a file says them."""
