"""Motions that identify a robot well: designed by the information they give, within the limits of the robot."""
