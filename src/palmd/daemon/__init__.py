"""The 100 Hz process: pure steps in the middle, ports, sockets and clocks at the rim."""
