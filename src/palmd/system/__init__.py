"""What the rig is: its mechanism, its palms, its sensors, and how all of them are called."""
