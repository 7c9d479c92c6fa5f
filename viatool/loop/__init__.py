"""The closed loop over sets: what is seen from a set of poses, commanded, and where that leads."""
