"""The 100 Hz control process: pure steps inside; ports, sockets and clocks at its boundary."""
