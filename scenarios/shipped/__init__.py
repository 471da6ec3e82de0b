"""Every scenario of this package in its own modes: the figures and pictures of single flights."""
