"""Motion of the palms: kinematics, limits, motion plans and their execution, exploration. Pure."""
