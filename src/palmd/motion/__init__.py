"""What the palms do next: the rig's kinematics, its limits, motion plans and their execution. Pure."""
