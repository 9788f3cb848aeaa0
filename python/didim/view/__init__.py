"""`didim view`: a robot, its logs and its estimates in three dimensions, in a browser (extra ``view``, on viser)."""
