"""What is missing or wrong, found with the command that mends it."""
