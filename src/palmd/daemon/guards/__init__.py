"""Guards of the arm and the pads: pure functions of commands, reports, contacts and time."""
