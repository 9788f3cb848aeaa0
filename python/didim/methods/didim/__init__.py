"""DIDIM: closed-loop output error on the torques, by linear least squares per iteration."""
