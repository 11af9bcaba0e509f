"""What starts and operates a whole stack, and the loop without wires."""
